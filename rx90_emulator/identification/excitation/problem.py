"""The stacked equations of excitation runs: what each joint's torque was, and what it is linear in.

**Rows.** Torque and columns pass the same low-pass and are kept some two times per period of its bandwidth. A joint's
equation at an instant is left out while an element that acts on the joint stands still (`standstill`): its torque is
then anything up to its break-away value. Reversals, in which an element passes through rest, are kept: around them
alone the bristles show, and Coulomb columns, filtered like the torque, have their step at the right time.

When an element slides, when it rests, and when it passes through rest.

Below 0.05 rad/s (or, on slow arms, a tenth of its usual speed) the torque of an element follows the deflection of its
bristles rather than its speed. A reversal and a pause both pass below: a reversal at constant acceleration spends a
quarter of that time below a quarter of the speed, a pause most of it.

Which instants of excitation runs are repetitions of the same motion: periods of a run, runs that are played again.

What a model leaves out (ripple, load, cables) follows the motion and comes back with it. A motion that was recorded ten
times says no more of its misfit than one recording; deviations that take the repetitions for independent are up to the
root of ten too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.linear_parameters import BaseGroups, StandardColumns
from rx90_emulator.identification.excitation.payload import Payload

Motion = tuple[Array, Array, Array]
"""Position, velocity and acceleration, each of shape (m, n)."""


@dataclass(frozen=True, eq=False)
class ExcitationProblem:
    """The equations `torque` = `regressor` @ parameters + friction; rows sorted by run, joint, time.

    Attributes:
        arm: n joints, n_el friction elements.
        runs: at their full rate.
        columns: of the standard parameters.
        base: the groups of them that the columns of the regressor mean.
        run: number of each row's run, shape (r,).
        joint: number of its joint, shape (r,).
        sample: its sample in the run, shape (r,).
        place: its place among the run's filtered samples, shape (r,).
        time: s, shape (r,).
        torque: as recorded, less that of known payloads, filtered, Nm, shape (r,).
        payloads: of each run.
        payload: their torque, filtered, Nm, shape (r,).
        regressor: filtered columns of the b base parameters, shape (r, b).
        reversal: rows at which an element that acts on the joint passes through rest, shape (r,).
        uncertain: torques by which that of the rows may be off as a whole, such as by an identified drive gain: k of
            one standard deviation each, independent of each other, Nm, shape (r, k).
    """

    arm: RigidArm
    runs: tuple[FilteredRun, ...]
    columns: StandardColumns
    base: BaseGroups
    run: Index
    joint: Index
    sample: Index
    place: Index
    time: Array
    torque: Array
    payloads: tuple[Payload | None, ...]
    payload: Array
    regressor: Array
    reversal: Mask
    uncertain: Array

    @classmethod
    def of(
        cls,
        arm: RigidArm,
        runs: Sequence[FilteredRun],
        springs: Sequence[str] | None = None,
        payloads: Sequence[Payload | None] | None = None,
    ) -> ExcitationProblem:
        """Stack the equations of runs.

        Args:
            arm: kinematics, couplings and elements.
            runs: of this arm.
            springs: joints with a spring; by default those on which the arm's description has one.
            payloads: of each run; by default none.

        Raises:
            IdentificationError: for runs of other joints, payloads of another number, and if no joint moves.
        """
        carried = (None,) * len(runs) if payloads is None else tuple(payloads)
        _check_runs(arm, runs, carried)
        there = [name for name, k in zip(arm.names, arm.spring.tolist(), strict=True) if k]
        columns = StandardColumns.with_springs_on(arm, there if springs is None else springs)
        base = BaseGroups.of(columns)
        kept = [_kept_rows(number, run, arm) for number, run in enumerate(runs)]
        rows = {name: np.concatenate([part[name] for part in kept]) for name in kept[0]}
        if not len(rows["run"]):
            raise IdentificationError("no joint moves in any run; accepted: runs in which the joints move")
        empty = np.zeros(len(rows["run"]))
        bare = cls(
            arm, tuple(runs), columns, base, **rows, torque=empty, payloads=carried, payload=empty, regressor=empty,
            uncertain=np.empty((len(empty), 0)),
        )  # fmt: skip
        recorded = bare.rows_of([run.torque[:, :, None] for run in runs])[:, 0]
        regressor, payload = bare.through(np.eye(len(arm.names)))
        return replace(bare, torque=recorded - payload, payload=payload, regressor=regressor)

    def __len__(self) -> int:
        return len(self.torque)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the columns, shape (b,)."""
        return self.base.names

    @cached_property
    def phases(self) -> list[tuple[int, Index]]:
        """Return for each run the number of its motion and the phase of its filtered samples: see `repetition`."""
        return phases(self.runs)

    @cached_property
    def velocity(self) -> Array:
        """Return the elements' velocities at the rows, rad/s, shape (r, n_el)."""
        elements = self.arm.element_matrix.T
        return self._gathered(lambda number, rows: self.runs[number].velocity[self.sample[rows]] @ elements)

    def rows_of(self, along: Sequence[Array]) -> Array:
        """Return joint torques at the rows, filtered like the recorded ones.

        Args:
            along: for each run c joint torques at its full rate, shape (m, n, c).

        Returns:
            Shape (r, c).
        """
        filtered = [run.parallel(values) for run, values in zip(self.runs, along, strict=True)]
        return self._gathered(lambda number, rows: filtered[number][self.place[rows], self.joint[rows]])

    def element_rows(self, along: Sequence[Array]) -> Array:
        """Return elements' torques as joint torques at the rows, filtered like the recorded ones.

        Args:
            along: for each run c torques of each element at its full rate, shape (m, n_el, c).

        Returns:
            E^T times them, shape (r, n_el * c): the c columns of the first element, then those of the next.
        """
        filtered = [run.parallel(values) for run, values in zip(self.runs, along, strict=True)]
        share = self.arm.element_matrix.T

        def rows_of(number: int, rows: Index) -> Array:
            torque = filtered[number][self.place[rows]] * share[self.joint[rows]][:, :, None]
            return np.asarray(torque.reshape(len(rows), -1))

        return self._gathered(rows_of)

    def moved(self, motions: Sequence[Motion]) -> ExcitationProblem:
        """Return the same rows with the columns of other motions, one for each run at its times.

        What is computed of the result (its regressor, friction along its runs) are instruments for the original.
        """
        runs = tuple(
            replace(run, position=position, velocity=velocity, acceleration=acceleration, stamps=None)
            for run, (position, velocity, acceleration) in zip(self.runs, motions, strict=True)
        )
        other = replace(self, runs=runs, payloads=(None,) * len(runs))
        return replace(other, regressor=other.through(np.eye(len(self.arm.names)))[0])

    def through(self, share: Array) -> tuple[Array, Array]:
        """Return what reaches the rows of the base's columns and of the payloads, shape (r, b) and (r,).

        Args:
            share: of each joint's torque (row) in that of each joint (column), shape (n, n): the identity for all of
                it, other matrices for the part of one motor.
        """
        return _stacked(self, share)

    def _gathered(self, rows_of: Callable[[int, Index], Array]) -> Array:
        """Return rows that are made run by run."""
        return np.concatenate([rows_of(k, np.flatnonzero(self.run == k)) for k in range(len(self.runs))])


def _columns(problem: ExcitationProblem, run: FilteredRun, samples: slice) -> Array:
    motion = run.position[samples], run.velocity[samples], run.acceleration[samples]
    return problem.columns.torque(*motion)


def _stacked(problem: ExcitationProblem, share: Array) -> tuple[Array, Array]:
    leading, n = list(problem.base.leading), len(problem.arm.names)
    regressor, payload = np.zeros((len(problem.run), len(leading))), np.zeros(len(problem.run))
    for number, (run, body) in enumerate(zip(problem.runs, problem.payloads, strict=True)):
        for samples, rows in run.blocks():
            values = _columns(problem, run, samples)
            inside = (problem.run == number) & (problem.place >= rows.start) & (problem.place < rows.stop)
            here = np.flatnonzero(inside)
            place, to = problem.place[here] - rows.start, share[:, problem.joint[here]].T
            filtered = run.parallel(values[:, :, leading])[place]
            regressor[here] = np.einsum("rj,rjb->rb", to, filtered)
            if body is not None:
                torque = run.parallel(values[:, :, 10 * n - 10 : 10 * n] @ body.parameters())
                payload[here] = np.sum(to * torque[place], axis=1)
    return regressor, payload


def _kept_rows(number: int, run: FilteredRun, arm: RigidArm) -> dict[str, Array | Index | Mask]:
    state = element_states(run, arm.element_matrix)
    acts = arm.element_matrix != 0.0
    rests = (state == SlidingState.RESTS) @ acts
    passes = (state == SlidingState.PASSES) @ acts
    joint, place = np.nonzero(~rests.T)
    return {
        "run": np.full(len(joint), number, dtype=np.intp),
        "joint": joint,
        "sample": run.rows[place],
        "place": place,
        "time": run.time[run.rows[place]],
        "reversal": passes[place, joint],
    }


def _check_runs(arm: RigidArm, runs: Sequence[FilteredRun], payloads: Sequence[Payload | None]) -> None:
    if not runs:
        raise IdentificationError("no excitation run; accepted: one or more")
    if len(payloads) != len(runs):
        raise IdentificationError(f"{len(payloads)} payloads for {len(runs)} runs; accepted: one (or none) for each")
    for run in runs:
        if run.names != arm.names:
            raise IdentificationError(
                f"{run.source.path}: joints {', '.join(run.names)}; accepted: {', '.join(arm.names)}"
            )


_SLOW_SPEED = 0.05  # rad/s: on real arms rows below it pull Coulomb friction 10 to 25 % low
_SLOW_SHARE = 0.1  # of the speed that an element exceeds in a tenth of the run
_MIN_SLOW_SPEED = 1e-3  # rad/s: an element that is never faster stands
_PAUSE_SHARE = 0.5  # share of a slow stretch below a quarter of the threshold: a pause; a reversal has a quarter
_STOP_SHARE = 0.1  # of the threshold: below it an element that does not change its direction has stopped for an instant


class SlidingState(IntEnum):
    """What an element does."""

    SLIDES = 0
    PASSES = 1
    RESTS = 2


def element_states(run: FilteredRun, elements: Array) -> NDArray[np.int8]:
    """Return what each element does at the run's rows, shape (k, n_el).

    The low-pass of the torque reaches half a period of its bandwidth to both sides: a row as near to a pause as that
    counts as resting.

    Args:
        run: of n joints.
        elements: E, joint velocities to those of the elements, shape (n_el, n).
    """
    velocity = run.velocity @ elements.T
    reach = math.ceil(0.5 * run.rate / run.bandwidths.torque)
    state = np.empty((len(run.rows), len(elements)), dtype=np.int8)
    for e, speed in enumerate(velocity.T):
        threshold = slow_below(speed)
        rests, passes = _slow_stretches(speed, threshold)
        stops, _ = _slow_stretches(speed, _STOP_SHARE * threshold)
        state[:, e] = np.where(
            _near(rests | stops, reach)[run.rows], SlidingState.RESTS, passes[run.rows] * SlidingState.PASSES
        )
    return state


def slow_below(velocity: Array) -> float:
    """Return the speed below which an element counts as slow, rad/s, from its velocity in a run, shape (m,)."""
    usual = float(np.quantile(np.abs(velocity), 0.9))
    return max(min(_SLOW_SPEED, _SLOW_SHARE * usual), _MIN_SLOW_SPEED)


def _slow_stretches(velocity: Array, threshold: float) -> tuple[Mask, Mask]:
    """Return where an element rests and where it passes through rest, each of shape (m,)."""
    slow = np.abs(velocity) < threshold
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    rests, passes = np.zeros_like(slow), np.zeros_like(slow)
    for start, stop in edges.reshape(-1, 2).tolist():
        inner = float(np.mean(np.abs(velocity[start:stop]) < 0.25 * threshold))
        whole = start > 0 and stop < len(velocity)
        # A single sample tells no share.
        through = whole and velocity[start - 1] * velocity[stop] < 0.0 and (inner <= _PAUSE_SHARE or stop - start == 1)
        (passes if through else rests)[start:stop] = True
    return rests, passes


def _near(mask: Mask, reach: int) -> Mask:
    """Return the samples within `reach` of a true one."""
    count = np.cumsum(np.concatenate([np.zeros(reach + 1), mask, np.zeros(reach)]))
    return np.asarray(count[2 * reach + 1 :] - count[: -2 * reach - 1] > 0.0)


_SAME_MOTION = 0.95  # similarity of velocities from which on two stretches are the same motion
_DECORRELATED = 0.5  # similarity below which a lag has left the neighbourhood of 0
_MIN_OVERLAP = 0.3  # share of the motion's energy that two stretches have in common, at least
_RATE_TOLERANCE = 0.01  # relative difference between the row rates of runs that can be compared


def phases(runs: Sequence[FilteredRun]) -> list[tuple[int, Index]]:
    """Return for each run the number of its motion and the phase of each of its rows' instants, shape (k,).

    Instants with the same motion and phase are repetitions of each other.
    """
    scale = np.sqrt(np.mean(np.concatenate([run.velocity**2 for run in runs]), axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    motions: list[tuple[Array, float, int]] = []
    found = []
    for run in runs:
        velocity, rate = run.velocity[run.rows] / scale, run.rate / run.down
        number, shift = _repeated_motion(velocity, rate, motions)
        if number == len(motions):
            motions.append((velocity, rate, _period(velocity)))
        place = np.arange(len(velocity)) + shift
        period = motions[number][2]
        found.append((number, place % period if period else place))
    # A run that began earlier than the first of its motion has places before 0.
    earliest = {number: min(int(p.min()) for k, p in found if k == number and len(p)) for number, _ in found}
    return [(number, place - earliest[number]) for number, place in found]


def _repeated_motion(velocity: Array, rate: float, motions: Sequence[tuple[Array, float, int]]) -> tuple[int, int]:
    """Return the motion that a run repeats, by how many rows it begins later there; a new number if it repeats none."""
    for number, (other, its_rate, _) in enumerate(motions):
        if abs(rate / its_rate - 1.0) < _RATE_TOLERANCE:
            alike, shared = _similarity(other, velocity)
            best = int(np.argmax(np.where(shared > _MIN_OVERLAP, alike, -1.0)))
            if alike[best] > _SAME_MOTION and shared[best] > _MIN_OVERLAP:
                return number, best - (len(velocity) - 1)
    return len(motions), 0


def _period(velocity: Array) -> int:
    """Return the period of a run in rows, velocities of shape (k, n); 0 if it does not repeat itself."""
    alike, shared = _similarity(velocity, velocity)
    alike, shared = alike[len(velocity) - 1 :], shared[len(velocity) - 1 :]
    left = np.flatnonzero(alike < _DECORRELATED)
    candidates = np.flatnonzero(_peaks(alike) & (alike > _SAME_MOTION) & (shared > _MIN_OVERLAP))
    candidates = candidates[candidates > (left[0] if len(left) else len(alike))]
    return int(candidates[0]) if len(candidates) else 0


def _peaks(values: Array) -> Mask:
    padded = np.pad(values, 1, constant_values=-np.inf)
    return np.asarray((values >= padded[:-2]) & (values >= padded[2:]))


def _similarity(first: Array, second: Array) -> tuple[Array, Array]:
    """Return how alike two motions are at each lag, 1 for the same, and the share of the smaller energy in the overlap.

    At lag number l, row k of `second` lies on row k + l - (len(second) - 1) of `first`.
    """
    product = sum(correlate(a, b, method="fft") for a, b in zip(first.T, second.T, strict=True))
    energy, other = (np.concatenate([[0.0], np.cumsum((values**2).sum(axis=1))]) for values in (first, second))
    lag = np.arange(-(len(second) - 1), len(first))
    begin, end = np.maximum(lag, 0), np.minimum(lag + len(second), len(first))
    mine, its = energy[end] - energy[begin], other[end - lag] - other[begin - lag]
    least = max(min(energy[-1], other[-1]), 1e-300)
    return 2.0 * product / np.maximum(mine + its, 1e-300 + 1e-9 * least), np.minimum(mine, its) / least
