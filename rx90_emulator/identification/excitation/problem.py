"""The stacked equations of excitation runs: the torque of each joint, and the columns that it is linear in.

Friction apart, the torque is linear in standard parameters: those of links, rotors, springs and offsets. Base
parameters are the combinations of them that the torque depends on (Gautier 1991, "Numerical calculation of the base
inertial parameters of robots"): the columns of the torque at random motions are orthogonalised one after the other. A
column in the space of the previous ones contains nothing new; its parameter joins the groups of the columns that it is
a combination of.

Torque and columns pass the same low-pass, and some two samples per period of its bandwidth are used. A joint's equation
at an instant is excluded while an element that acts on the joint stands still: its torque may then have any value up to
break-away. Reversals, in which an element passes through rest, are included: only they contain information on bristles,
and the Coulomb columns, filtered like the torque, have their step at the right time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import correlate

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.filtering import SLOW_SHARE, SLOW_SPEED, FilteredRun
from rx90_emulator.identification.records import stretches

_LINK = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


class StandardColumns:
    """The torque of an arm per unit of each standard parameter.

    Args:
        arm: kinematics and couplings, and which joints have a spring of the torque -k sin(q); its inertias and the
            sizes of the springs are not used.
        rotors: whether the torque contains that of the rotors. Sensors between gear and link do not measure it, and its
            columns are 0.
    """

    def __init__(self, arm: RigidArm, *, rotors: bool = True) -> None:
        self.arm = arm
        self.rotors = rotors
        self.springs = np.flatnonzero(arm.spring).tolist()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of P parameters, with the numbers of the joints, from 1 at the base.

        m kg, mx .. mz kg m and Ixx .. Izz kg m^2 for links, about the origins of their joints and in their frames; Ia
        kg m^2, for motors seen through their gears; k Nm, for springs; offset Nm.
        """
        joints = range(1, len(self.arm.names) + 1)
        links = [f"{kind}_{joint}" for joint in joints for kind in _LINK]
        rotors = [f"{'Ia'}_{joint}" for joint in joints]
        offsets = [f"{'offset'}_{joint}" for joint in joints]
        return (*links, *rotors, *(f"k_{joint + 1}" for joint in self.springs), *offsets)

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the columns along a motion, whose arrays have shape (m, n): shape (m, n, P)."""
        n = len(self.arm.names)
        turns = self.arm.coupling
        links = self.arm.regressor(position, velocity, acceleration)
        # Motor j turns with row j of the coupling; its inertia acts back on every joint of that row.
        rotors = (acceleration @ turns.T)[:, None, :] * turns.T * self.rotors
        springs = np.sin(position)[:, :, None] * np.eye(n)[:, self.springs]
        offsets = np.broadcast_to(np.eye(n), (len(position), n, n))
        return np.concatenate([links, rotors, springs, offsets], axis=2)

    def values(self) -> Array:
        """Return the parameters of the arm's description, shape (P,), for a prior. Offsets are 0."""
        inverse = np.linalg.inv(self.arm.coupling)
        rotors = np.diag(inverse.T @ self.arm.rotor @ inverse) * self.rotors
        parts = self.arm.inertial, rotors, self.arm.spring[self.springs], np.zeros(len(self.arm.names))
        return np.concatenate(parts)


_RANDOM_MOTIONS = 60  # each gives as many equations as there are joints
_SEED = 20100
_INDEPENDENT_SHARE = 1e-5  # least part of an independent column outside the others' space; 1.5708 for pi/2 leaves less
_MIN_COEFFICIENT = 1e-5  # in a group, for the same reason
_REGROUPED_KINDS = ("m_", "mz_", "Iyy_")  # kinds that join other groups by Khalil's convention: they come last


@dataclass(frozen=True, eq=False)
class BaseGroups:
    """Groups of standard parameters.

    Attributes:
        standard: names of the P standard parameters.
        leading: index of the parameter that each of b groups is named after, shape (b,): the columns to use.
        combination: G, base parameters = G @ standard parameters, shape (b, P); 1 at the leading ones.
    """

    standard: tuple[str, ...]
    leading: tuple[int, ...]
    combination: Array

    @classmethod
    def of(cls, columns: StandardColumns) -> BaseGroups:
        """Find the groups of an arm, from random positions, velocities and accelerations (always the same ones)."""
        rng = np.random.default_rng(_SEED)
        names = columns.names
        motion = (rng.uniform(-width, width, (_RANDOM_MOTIONS, len(columns.arm.names))) for width in (np.pi, 2.0, 5.0))
        matrix = columns.torque(*motion)[:, columns.arm.identified].reshape(-1, len(names))
        size = np.linalg.norm(matrix, axis=0)
        basis = np.zeros((len(matrix), 0))
        chosen = []
        for k in sorted(range(len(names)), key=lambda k: (names[k].startswith(_REGROUPED_KINDS), k)):
            remainder = matrix[:, k] - basis @ (basis.T @ matrix[:, k])
            remainder = remainder - basis @ (basis.T @ remainder)  # once more: rounding of the first pass
            norm = float(np.linalg.norm(remainder))
            if size[k] > _INDEPENDENT_SHARE * size.max() and norm > _INDEPENDENT_SHARE * size[k]:
                basis = np.column_stack([basis, remainder / norm])
                chosen.append(k)
        leading = sorted(chosen)
        combination = np.asarray(np.linalg.lstsq(matrix[:, leading], matrix, rcond=None)[0], dtype=np.float64)
        combination[np.abs(combination) < _MIN_COEFFICIENT] = 0.0
        combination[:, leading] = np.eye(len(leading))
        return cls(names, tuple(leading), combination)

    @property
    def names(self) -> tuple[str, ...]:
        """Return short names, shape (b,): the leading parameter, with an R if others belong to its group (Khalil)."""
        alone = (np.count_nonzero(self.combination, axis=1) == 1).tolist()
        leading = [self.standard[k] for k in self.leading]
        return tuple(n if one else n.replace("_", "R_", 1) for n, one in zip(leading, alone, strict=True))

    @property
    def groups(self) -> tuple[str, ...]:
        """Return each group in words, shape (b,), such as "mx_2 + 0.45 m_3"; SI units."""
        texts = []
        for lead, row in zip(self.leading, self.combination, strict=True):
            text = self.standard[lead]
            for k in np.flatnonzero(row).tolist():
                if k != lead:
                    size = "" if abs(abs(row[k]) - 1.0) < 1e-6 else f"{abs(row[k]):.4g} "
                    text += f" {'-' if row[k] < 0.0 else '+'} {size}{self.standard[k]}"
            texts.append(text)
        return tuple(texts)


_PRIOR_BOUNDS = (1e-6, 1e4)  # of its relative deviation: below and above, a description says all or nothing
_UNINFORMATIVE = 1e4  # deviations of an unknown parameter, in units of the arm's largest one of its kind


class Prior(NamedTuple):
    """A normal distribution of q parameters: its mean, shape (q,), and the inverse of its covariance, (q, q)."""

    value: Array
    precision: Array


def described_inertials(columns: StandardColumns, base: BaseGroups, relative: float) -> Prior:
    """Return the prior of the base parameters from the inertials of the arm's description.

    Args:
        columns: of the arm.
        base: its groups.
        relative: standard deviation of a link's mass over the mass; that of its first moment is this share of mass
            times radius, that of its inertia of mass times radius squared. The radius is that of gyration about the
            joint, at least 1 cm. Rotors and springs vary by the same share if they are given; offsets, and rotors that
            are not given, are unknown.
    """
    low, high = _PRIOR_BOUNDS
    if not low <= relative <= high:
        raise IdentificationError(f"relative deviation of the prior: {relative:g}; accepted: {low:g} to {high:g}")
    value = columns.values()
    count = 10 * len(columns.arm.names)
    if not value[:count].any():
        raise IdentificationError("a prior from a description without <inertial>; accepted: no --prior, or inertials")
    links = value[:count].reshape(-1, 10)
    mass = np.maximum(links[:, 0], 1e-6)
    radius = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(axis=1) / 2.0 / mass, 1e-4))
    sizes = mass[:, None] * radius[:, None] ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    deviation = relative * np.concatenate([sizes.ravel(), np.abs(value[count:])])
    deviation[deviation == 0.0] = _UNINFORMATIVE * float(deviation.max())
    covariance = (base.combination * deviation**2) @ base.combination.T
    size = np.sqrt(np.diag(covariance))
    precision = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
    return Prior(base.combination @ value, precision)


@dataclass(frozen=True, eq=False)
class ExcitationProblem:
    """The equations `torque` = `regressor` @ parameters + friction; rows sorted by run, joint, time.

    Attributes:
        arm: n joints, n_el friction elements.
        runs: at their full rate.
        columns: of the standard parameters.
        base: groups of standard parameters that the regressor's columns belong to.
        run: number of each row's run, shape (r,).
        joint: number of each row's joint, shape (r,).
        place: index of each row among the run's filtered samples, shape (r,).
        time: s, shape (r,).
        reversal: rows at which an element that acts on the joint passes through rest, shape (r,).
        torque: recorded torque, filtered, Nm, shape (r,).
        regressor: filtered columns of the b base parameters, shape (r, b).
    """

    arm: RigidArm
    runs: tuple[FilteredRun, ...]
    columns: StandardColumns
    base: BaseGroups
    run: Index
    joint: Index
    place: Index
    time: Array
    reversal: Mask
    torque: Array
    regressor: Array

    @classmethod
    def of(cls, arm: RigidArm, runs: Sequence[FilteredRun], *, rotors: bool = True) -> ExcitationProblem:
        """Stack the equations of runs.

        Args:
            arm: kinematics, couplings and elements; springs are identified on the joints that have one in it.
            runs: of this arm.
            rotors: as in `StandardColumns`.
        """
        bare = cls.without_columns(arm, runs, rotors=rotors)
        return replace(bare, regressor=bare._base_columns())

    @classmethod
    def without_columns(cls, arm: RigidArm, runs: Sequence[FilteredRun], *, rotors: bool = True) -> ExcitationProblem:
        """Return the rows of runs with their torque and no regressor; arguments as in `of`."""
        for one in runs:
            if one.names != arm.names:
                there = ", ".join(one.names)
                wanted = ", ".join(arm.names)
                raise IdentificationError(f"{one.source.path}: joints {there}; accepted: {wanted}")
        columns = StandardColumns(arm, rotors=rotors)
        acts = arm.element_matrix != 0.0
        found = []
        for number, one in enumerate(runs):
            resting, passes = element_states(one, arm.element_matrix)
            joint, place = np.nonzero((~(resting @ acts) & arm.identified).T & one.whole)
            time = one.time[one.rows[place]]
            reversal = (passes @ acts)[place, joint]
            found.append((np.full(len(joint), number), joint, place, time, reversal))
        run, joint, place, time, reversal = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if not len(run):
            raise IdentificationError("no joint moves in any run; accepted: runs in which the joints move")
        empty = np.empty((len(run), 0))
        base = BaseGroups.of(columns)
        bare = cls(arm, tuple(runs), columns, base, run, joint, place, time, reversal, empty, empty)
        return replace(bare, torque=bare.rows_of([one.torque[:, :, None] for one in runs])[:, 0])

    def __len__(self) -> int:
        return len(self.run)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the columns, shape (b,)."""
        return self.base.names

    @property
    def parameters(self) -> int:
        """Return how many the simplest model has: base parameters, Coulomb and viscous torque of each element."""
        return len(self.names) + 2 * len(self.arm.element_names)

    @cached_property
    def sample(self) -> Index:
        """Return each row's index among the filtered samples of all runs, one run after the other, shape (r,)."""
        return np.asarray(np.cumsum([0, *(len(run.rows) for run in self.runs)])[self.run] + self.place)

    @cached_property
    def _phases(self) -> list[tuple[int, Index]]:
        return phases(self.runs)

    @cached_property
    def motion(self) -> Index:
        """Return the number of each row's motion, shape (r,); repetitions have the same number (`phases`)."""
        return np.array([motion for motion, _ in self._phases])[self.run]

    @cached_property
    def phase(self) -> Index:
        """Return each row's index in its motion, shape (r,); repetitions have the same index."""
        return np.concatenate([phase for _, phase in self._phases])[self.sample]

    @cached_property
    def motion_lengths(self) -> Index:
        """Return the number of phases of each motion."""
        lengths = np.ones(1 + max(motion for motion, _ in self._phases), dtype=np.intp)
        for motion, phase in self._phases:
            lengths[motion] = max(lengths[motion], phase.max(initial=0) + 1)
        return lengths

    @cached_property
    def velocity(self) -> Array:
        """Return the elements' velocities at the rows, rad/s, shape (r, n_el)."""
        return np.concatenate([run.velocity[run.rows] for run in self.runs])[self.sample] @ self.arm.element_matrix.T

    def rows_of(self, along: Sequence[Array]) -> Array:
        """Return joint torques at the rows, filtered like the recorded ones, shape (r, c).

        Args:
            along: for each run c joint torques at its full rate, shape (m, n, c).
        """
        return self._filtered(along)[self.sample, self.joint]

    def element_rows(self, along: Sequence[Array]) -> Array:
        """Return elements' torques as joint torques at the rows, filtered like the recorded ones.

        Args:
            along: for each run c torques of each element at its full rate, shape (m, n_el, c).

        Returns:
            E^T times them, shape (r, n_el * c): the c columns of the first element, then those of the next.
        """
        torque = self._filtered(along)[self.sample] * self.arm.element_matrix.T[self.joint][:, :, None]
        return np.asarray(torque.reshape(len(torque), -1))

    def _filtered(self, along: Sequence[Array]) -> Array:
        return np.concatenate([run.parallel(values) for run, values in zip(self.runs, along, strict=True)])

    def _base_columns(self) -> Array:
        """Return the filtered columns of the base parameters, shape (r, b)."""
        leading = list(self.base.leading)
        regressor = np.zeros((len(self), len(leading)))
        for number, run in enumerate(self.runs):
            for samples, rows in run.blocks():
                values = self.columns.torque(run.position[samples], run.velocity[samples], run.acceleration[samples])
                here = np.flatnonzero((self.run == number) & (self.place >= rows.start) & (self.place < rows.stop))
                filtered = run.parallel(values[:, :, leading])
                regressor[here] = filtered[self.place[here] - rows.start, self.joint[here]]
        return regressor


_MIN_SLOW_SPEED = 1e-3  # rad/s: an element that is never faster stands still
_PAUSE_SHARE = 0.5  # minimal share of a pause below a quarter of the threshold; for a reversal it is a quarter
_STOP_SHARE = 0.1  # of the threshold: below it, an element that keeps its direction has stopped for an instant


def element_states(run: FilteredRun, elements: Array) -> tuple[Mask, Mask]:
    """Return where each element rests and where it passes through rest at the run's rows, each of shape (k, n_el).

    Below 0.05 rad/s (or, on slow arms, a tenth of its usual speed) the torque of an element depends on the deflection
    of its bristles rather than on its speed. A reversal and a pause both pass below: a reversal at constant
    acceleration spends a quarter of that time below a quarter of the speed, a pause most of it. The low-pass of the
    torque extends over half a period of its bandwidth on both sides: a row as near to a pause as that counts as
    resting.

    Args:
        run: of n joints.
        elements: E, joint velocities to those of the elements, shape (n_el, n).
    """
    reach = math.ceil(0.5 * run.rate / run.bandwidths.torque)
    states = np.empty((2, len(run.rows), len(elements)), dtype=np.bool_)
    for e, velocity in enumerate((run.velocity @ elements.T).T):
        usual = float(np.quantile(np.abs(velocity), 0.9))
        threshold = max(min(SLOW_SPEED, SLOW_SHARE * usual), _MIN_SLOW_SPEED)
        resting, passes = _slow_stretches(velocity, threshold)
        resting |= _slow_stretches(velocity, _STOP_SHARE * threshold)[0]
        near = maximum_filter1d(resting, 2 * reach + 1, mode="constant")
        states[:, :, e] = near[run.rows], (passes & ~near)[run.rows]
    return states[0], states[1]


def _slow_stretches(velocity: Array, threshold: float) -> tuple[Mask, Mask]:
    """Return where an element rests and where it passes through rest, each of shape (m,)."""
    slow = np.abs(velocity) < threshold
    resting = np.zeros_like(slow)
    passes = np.zeros_like(slow)
    for start, stop in stretches(slow):
        inner = float(np.mean(np.abs(velocity[start:stop]) < 0.25 * threshold))
        whole = start > 0 and stop < len(velocity)
        # A single sample has no share.
        through = whole and velocity[start - 1] * velocity[stop] < 0.0 and (inner <= _PAUSE_SHARE or stop - start == 1)
        (passes if through else resting)[start:stop] = True
    return resting, passes


_MIN_MOTION_SIMILARITY = 0.95  # similarity of velocities above which two stretches are the same motion
_DECORRELATED = 0.5  # similarity below which a lag is no longer near 0
_MIN_OVERLAP = 0.3  # least share of the motion's energy that two stretches have in common
_RATE_TOLERANCE = 0.01  # relative difference between the row rates of runs that can be compared


def phases(runs: Sequence[FilteredRun]) -> list[tuple[int, Index]]:
    """Return for each run the number of its motion and the phase of each of its rows' instants, shape (k,).

    Instants with the same motion and phase are repetitions of each other: periods of a run, or runs that are repeated.
    Effects outside the model (ripple, load, cables) follow the motion and return with it. A motion that was recorded
    ten times contains no more information on its misfit than one recording; deviations that treat the repetitions as
    independent are too small by up to the square root of ten.
    """
    scale = np.sqrt(np.mean(np.concatenate([run.velocity**2 for run in runs]), axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    motions: list[tuple[Array, float, int]] = []  # velocity, rate and period of the first run of each motion
    found = []
    for run in runs:
        velocity = run.velocity[run.rows] / scale
        rate = run.rate / run.down
        repeated = ((k, _shift(velocity, rate, *motion[:2])) for k, motion in enumerate(motions))
        number, shift = next((pair for pair in repeated if pair[1] is not None), (len(motions), 0))
        if number == len(motions):
            motions.append((velocity, rate, _period(velocity)))
        place = np.arange(len(velocity)) + (shift or 0)
        period = motions[number][2]
        found.append((number, place % period if period else place))
    # A run that began earlier than the first run of its motion has indices below 0.
    earliest = {number: min(int(p.min()) for k, p in found if k == number and len(p)) for number, _ in found}
    return [(number, place - earliest[number]) for number, place in found]


def _shift(velocity: Array, rate: float, other: Array, its_rate: float) -> int | None:
    """Return by how many rows a run begins later in a motion that it repeats; None if it does not repeat it."""
    if abs(rate / its_rate - 1.0) >= _RATE_TOLERANCE:
        return None
    similarity, shared = _similarity(other, velocity)
    best = int(np.argmax(np.where(shared > _MIN_OVERLAP, similarity, -1.0)))
    return (
        best - (len(velocity) - 1)
        if similarity[best] > _MIN_MOTION_SIMILARITY and shared[best] > _MIN_OVERLAP
        else None
    )


def _period(velocity: Array) -> int:
    """Return the period of a run in rows, velocities of shape (k, n); 0 if it does not repeat itself."""
    similarity, shared = (values[len(velocity) - 1 :] for values in _similarity(velocity, velocity))
    padded = np.pad(similarity, 1, constant_values=-np.inf)
    peak = (similarity >= padded[:-2]) & (similarity >= padded[2:])
    repeated = np.flatnonzero(peak & (similarity > _MIN_MOTION_SIMILARITY) & (shared > _MIN_OVERLAP))
    decorrelated = np.flatnonzero(similarity < _DECORRELATED)
    repeated = repeated[repeated > decorrelated[0]] if len(decorrelated) else decorrelated
    return int(repeated[0]) if len(repeated) else 0


def _similarity(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the similarity of two motions at each lag, 1 if equal, and the share of the smaller energy in the overlap.

    At lag number l, row k of `second` lies on row k + l - (len(second) - 1) of `first`.
    """
    product = sum(correlate(a, b, method="fft") for a, b in zip(first.T, second.T, strict=True))
    energy = np.concatenate([[0.0], np.cumsum((first**2).sum(axis=1))])
    other = np.concatenate([[0.0], np.cumsum((second**2).sum(axis=1))])
    lag = np.arange(-(len(second) - 1), len(first))
    begin = np.maximum(lag, 0)
    end = np.minimum(lag + len(second), len(first))
    own = energy[end] - energy[begin]
    its = other[end - lag] - other[begin - lag]
    least = max(min(energy[-1], other[-1]), 1e-300)
    return 2.0 * product / np.maximum(own + its, 1e-300 + 1e-9 * least), np.minimum(own, its) / least
