"""The rows of excitation runs: filtered torque, the columns of the rigid body, and friction along the motion.

Torque and columns pass the same low-pass, and some two samples per period of its bandwidth are used. A joint's equation
at an instant is left out while an element that acts on the joint rests: its torque may then have any value up to
break-away. Reversals, in which an element passes through rest, stay: only they contain information on bristles, and the
Coulomb columns, filtered like the torque, have their step at the right time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import correlate

from rx90_common.base.arrays import Array, Index, Mask, column_rms, rms
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.elements import FrictionRows
from rx90_common.estimation.law import Law, Part, Speeds
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import stretches
from rx90_emulator.identification.rows.filtering import (
    LEAST_SPEED,
    USUAL_SPEED,
    FilteredRun,
    moving_in_any,
)
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns

TIME_BLOCKS = 20
"""Of all runs together: long beside the time in which residuals are correlated, and enough for a deviation."""
SLOW_SPEED = 0.05
"""rad/s: below it, or a quarter of the usual speed, an element is near a reversal or at rest. On real arms, such rows
pull Coulomb friction 10 to 25 % low."""
SLOW_SHARE = 0.25
"""Of the usual speed: a slow arm keeps most of its rows."""
PAUSE_SHARE = 0.5
"""Share of a slow stretch below a quarter of the threshold from which it is a pause; of a reversal it is a quarter."""
STOP_SHARE = 0.1
"""Of the threshold: below it, an element that keeps its direction has stopped for an instant."""
SPEED_TAIL = 1.0
"""Percent of the speeds that are left out at both ends of an element's range."""
VISIBLE_PRESLIDING = 0.02
"""Least presliding distance that shows, as a share of the way within a period of the bandwidth after a reversal."""
SAME_MOTION = 0.95
"""Correlation of velocities from which two stretches are the same motion."""


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
        reversal: rows at which an element that acts on the joint passes through rest, shape (r,).
    """

    arm: RigidArm
    runs: tuple[FilteredRun, ...]
    columns: StandardColumns
    base: BaseGroups
    run: Index
    joint: Index
    place: Index
    reversal: Mask

    @classmethod
    def of(
        cls,
        arm: RigidArm,
        runs: Sequence[FilteredRun],
        *,
        rotors: bool = True,
        like: ExcitationProblem | None = None,
    ) -> ExcitationProblem:
        """Stack the equations of runs.

        Args:
            arm: kinematics, couplings and elements; springs are identified on the joints that have one in it.
            runs: of this arm.
            rotors: as in `StandardColumns`.
            like: equations whose parameters and joints these have; by default those that the runs tell.
        """
        moving = moving_in_any([run.velocity for run in runs], arm.identified)
        missing = f"no joint moves in any run: {', '.join(arm.names)}; accepted: runs in which the joints move"
        if like is not None:
            moving &= np.isin(np.arange(len(moving)), like.joint)
            missing = f"{runs[0].source.path}: no joint of the excitation runs moves; accepted: runs in which one does"
        acts = (arm.element_matrix != 0.0) & moving
        rows = []
        for number, run in enumerate(runs):
            resting, passes = element_states(run, arm.element_matrix)
            joint, place = np.nonzero((~(resting @ acts) & arm.identified & moving).T)
            rows.append(
                np.column_stack(
                    [np.full(len(joint), number), joint, place, (passes @ acts)[place, joint]]
                )
            )
        table = np.concatenate(rows)
        if not len(table):
            raise IdentificationError(missing)
        if like is None:
            columns = StandardColumns(arm, rotors=rotors)
            position = np.concatenate([run.position for run in runs])
            base = BaseGroups.of(columns, np.where(moving, np.nan, np.median(position, axis=0)))
        else:
            columns = like.columns
            base = like.base
        return cls(
            arm=arm,
            runs=tuple(runs),
            columns=columns,
            base=base,
            run=table[:, 0],
            joint=table[:, 1],
            place=table[:, 2],
            reversal=table[:, 3] != 0,
        )

    def other(self, runs: Sequence[FilteredRun]) -> ExcitationProblem:
        """Return the equations of other runs of the same arm, for the same parameters and joints."""
        return ExcitationProblem.of(self.arm, runs, like=self)

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
        return np.cumsum([0, *(len(run.rows) for run in self.runs)])[self.run] + self.place

    @cached_property
    def recorded(self) -> Array:
        """Return the recorded torques of all runs' filtered samples, filtered, Nm, shape (k, n)."""
        return np.concatenate([run.parallel(run.torque) for run in self.runs])

    @cached_property
    def torque(self) -> Array:
        """Return the recorded torque of the rows, filtered, Nm, shape (r,)."""
        return self.recorded[self.sample, self.joint]

    @cached_property
    def regressor(self) -> Array:
        """Return the filtered columns of the b base parameters, shape (r, b)."""
        leading = list(self.base.leading)
        regressor = np.zeros((len(self), len(leading)))
        for number, run in enumerate(self.runs):
            for samples, rows in run.blocks():
                values = self.columns.torque(
                    run.position[samples], run.velocity[samples], run.acceleration[samples]
                )
                here = np.flatnonzero(
                    (self.run == number) & (self.place >= rows.start) & (self.place < rows.stop)
                )
                filtered = run.parallel(values[:, :, leading])
                regressor[here] = filtered[self.place[here] - rows.start, self.joint[here]]
        return regressor

    @cached_property
    def time(self) -> Array:
        """Return the rows' times, s, shape (r,)."""
        return np.concatenate([run.time[run.rows] for run in self.runs])[self.sample]

    @cached_property
    def velocity(self) -> Array:
        """Return the elements' velocities at the rows, rad/s, shape (r, n_el)."""
        return (
            np.concatenate([run.velocity[run.rows] for run in self.runs])[self.sample]
            @ self.arm.element_matrix.T
        )

    @cached_property
    def block(self) -> Index:
        """Return the number of each row's block of time, shape (r,): about twenty, and repetitions share theirs.

        What a model lacks (ripple, load, cables) follows the motion and returns with it: a motion that was recorded ten
        times says no more about it than one recording.
        """
        phases = [_phase(run) for run in self.runs]
        length = sum(int(phase.max(initial=0)) + 1 for phase in phases) / TIME_BLOCKS
        blocks: list[Index] = []
        starts: list[int] = []
        for number, phase in enumerate(phases):
            same = next(
                (k for k in range(number) if _same_motion(self.runs[k], self.runs[number])), None
            )
            new = 1 + max((int(block.max(initial=-1)) for block in blocks), default=-1)
            starts.append(new if same is None else starts[same])
            blocks.append(np.asarray(phase // max(length, 1.0), dtype=np.intp) + starts[-1])
        return np.concatenate(blocks)[self.sample]

    def rows_of(self, along: Sequence[Array]) -> Array:
        """Return joint torques at the rows, filtered like the recorded ones, shape (r, c).

        Args:
            along: for each run c joint torques at its full rate, shape (m, n, c).
        """
        filtered = np.concatenate(
            [run.parallel(values) for run, values in zip(self.runs, along, strict=True)]
        )
        return filtered[self.sample, self.joint]

    def friction_rows(self) -> FrictionRows:
        """Return the rows for a fit of friction laws, with the rigid body as linear parameters."""
        elements = [
            ExcitationElement.of(self, number) for number in range(len(self.arm.element_names))
        ]
        group = self.run * len(self.arm.names) + self.joint
        group = np.unique(group, return_inverse=True)[1]
        prior = np.empty((0, self.regressor.shape[1]))
        return FrictionRows(self.torque, self.regressor, elements, group, self.block, prior)


def _phase(run: FilteredRun) -> Index:
    """Return the number of each row in its period; of a run that does not repeat itself, in the run, shape (k,)."""
    place = np.arange(len(run.rows))
    velocity = run.velocity[run.rows]
    scale = column_rms(velocity)
    velocity = velocity / np.where(scale > 0.0, scale, 1.0)
    energy = np.sum(velocity**2)
    if energy == 0.0:
        return place
    products = [correlate(column, column, method="fft")[len(place) - 1 :] for column in velocity.T]
    ahead = np.cumsum(np.sum(velocity**2, axis=1))
    shared = 0.5 * (ahead[::-1] + energy - np.append(0.0, ahead[:-1]))
    similarity = np.sum(products, axis=0) / np.maximum(shared, 1e-9 * energy)
    low = np.flatnonzero(similarity < 0.5 * SAME_MOTION)  # beyond the width of the peak at no lag
    high = np.flatnonzero((similarity > SAME_MOTION) & (place < 0.7 * len(place)))
    high = high[high > low[0]] if len(low) else low
    if not len(high):
        return place
    peak = high[0] + int(np.argmax(similarity[high[0] : high[0] + low[0] + 1]))
    return np.asarray(place % peak)


def _same_motion(first: FilteredRun, second: FilteredRun) -> bool:
    """Return whether two runs begin with the same motion, over two thirds of the longer one."""
    longest = max(len(first.rows), len(second.rows))
    count = min(len(first.rows), len(second.rows))
    ours = first.velocity[first.rows[:count]]
    theirs = second.velocity[second.rows[:count]]
    size = np.linalg.norm(ours) * np.linalg.norm(theirs)
    return bool(count > 2 * longest / 3 and np.sum(ours * theirs) > SAME_MOTION * size)


def element_states(run: FilteredRun, elements: Array) -> tuple[Mask, Mask]:
    """Return where each element rests and where it passes through rest at the run's rows, each of shape (k, n_el).

    A reversal and a pause both pass below the threshold: a reversal at constant acceleration spends a quarter of that
    time below a quarter of the speed, a pause most of it. The low-pass of the torque extends over half a period of its
    bandwidth on both sides: a row as near to a pause as that counts as resting.

    Args:
        run: of n joints.
        elements: E, joint velocities to those of the elements, shape (n_el, n).
    """
    reach = math.ceil(0.5 * run.rate / run.bandwidths.torque)
    resting = np.empty((len(run.rows), len(elements)), dtype=np.bool_)
    passing = np.empty_like(resting)
    for number, velocity in enumerate((run.velocity @ elements.T).T):
        usual = float(np.quantile(np.abs(velocity), USUAL_SPEED))
        threshold = max(min(SLOW_SPEED, SLOW_SHARE * usual), LEAST_SPEED)
        rests, passes = _slow_stretches(velocity, threshold)
        rests |= _slow_stretches(velocity, STOP_SHARE * threshold)[0]
        near = maximum_filter1d(rests, 2 * reach + 1, mode="constant")
        resting[:, number] = near[run.rows]
        passing[:, number] = (passes & ~near)[run.rows]
    return resting, passing


def _slow_stretches(velocity: Array, threshold: float) -> tuple[Mask, Mask]:
    """Return where an element rests and where it passes through rest, each of shape (m,)."""
    slow = np.abs(velocity) < threshold
    resting = np.zeros_like(slow)
    passes = np.zeros_like(slow)
    for start, stop in stretches(slow):
        inner = float(np.mean(np.abs(velocity[start:stop]) < 0.25 * threshold))
        whole = start > 0 and stop < len(velocity)
        # A single sample has no share.
        through = (
            whole
            and velocity[start - 1] * velocity[stop] < 0.0
            and (inner <= PAUSE_SHARE or stop - start == 1)
        )
        (passes if through else resting)[start:stop] = True
    return resting, passes


@dataclass(frozen=True, eq=False)
class ExcitationElement:
    """The rows of one friction element, whose torque is filtered like the recorded one.

    Attributes:
        runs: at their full rate.
        share: joint velocities to the element's, shape (n,).
        rows: of the problem, shape (s,).
        place: index of each of them among the filtered samples of all runs, shape (s,).
        factor: joint torque over element torque, shape (s,).
        speeds: with data.
    """

    runs: tuple[FilteredRun, ...]
    share: Array
    rows: Index
    place: Index
    factor: Array
    speeds: Speeds

    @classmethod
    def of(cls, problem: ExcitationProblem, number: int) -> ExcitationElement:
        """Return the rows of an element of a problem's arm."""
        share = problem.arm.element_matrix[number]
        rows = np.flatnonzero(share[problem.joint])
        speed = np.abs(problem.velocity[rows, number])
        low, high = (
            np.percentile(speed, (SPEED_TAIL, 100.0 - SPEED_TAIL)) if len(rows) else (0.0, 0.0)
        )
        distances = [1e-7]
        for run in problem.runs:
            acceleration = rms(run.acceleration @ share)
            distances.append(VISIBLE_PRESLIDING * 0.5 * acceleration / run.bandwidths.torque**2)
        speeds = Speeds(float(low), float(high), max(distances))
        return cls(
            problem.runs, share, rows, problem.sample[rows], share[problem.joint[rows]], speeds
        )

    def torque(self, law: Law, x: Array) -> tuple[Array, Array]:
        """Return the filtered torque and its derivatives."""
        parts = []
        for run in self.runs:
            velocity = run.velocity @ self.share
            torque, slopes = law.curve(velocity, x)
            if Part.BRISTLE in law.parts:
                torque, slopes = _with_bristle(
                    law, run.position @ self.share, 1.0 / run.rate, x, slopes
                )
            parts.append(run.parallel(np.column_stack([torque, slopes])))
        filtered = np.concatenate(parts)[self.place] * self.factor[:, None]
        return filtered[:, 0], filtered[:, 1:]


def _with_bristle(
    law: Law, position: Array, step: float, x: Array, steady: Array
) -> tuple[Array, Array]:
    """Return torque and derivatives along a motion, with the dry torque of a bristle in place of the steady one."""
    velocity = np.diff(position, prepend=position[:1]) / step
    dry, slopes = law.along(velocity, step, x)
    both = np.column_stack([dry, slopes])
    # Means over the steps that end and begin at a sample belong to its time.
    both[:-1] = 0.5 * (both[:-1] + both[1:])
    wet = [k for k, name in enumerate(law.names) if name in ("c2", "alpha")]
    both[:, 1:][:, wet] = steady[:, wet]
    viscous = law.names.index("c2")
    return both[:, 0] + steady[:, viscous] * x[viscous], both[:, 1:]
