"""The stacked equations of excitation runs: what each joint's torque was, and what it is linear in.

**Rows.** Torque and columns pass the same low-pass and are kept some two times per period of its bandwidth. A joint's
equation at an instant is left out while an element that acts on the joint stands still (`standstill`): its torque is
then anything up to its break-away value. Reversals, in which an element passes through rest, are kept: around them
alone the bristles show, and Coulomb columns, filtered like the torque, have their step at the right time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.base_groups import BaseGroups
from rx90_emulator.identification.excitation.columns import StandardColumns
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.repetition import phases
from rx90_emulator.identification.excitation.standstill import SlidingState, element_states
from rx90_emulator.identification.model.rigid_arm import RigidArm

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
