"""The stacked equations of excitation runs: what each joint's torque was, and what it is linear in.

**Rows.** Torque and columns pass the same low-pass and are kept some two times per period of its bandwidth. A joint's
equation at an instant is left out while an element that acts on the joint stands still (`standstill`): its torque is
then anything up to its break-away value. Reversals, in which an element passes through rest, are kept: around them
alone the bristles show, and Coulomb columns, filtered like the torque, have their step at the right time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.base_groups import BaseGroups
from rx90_emulator.identification.excitation.columns import StandardColumns
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.standstill import SlidingState, element_states
from rx90_emulator.identification.model.rigid_arm import RigidArm


@dataclass(frozen=True, eq=False)
class ExcitationProblem:
    """The equations `torque` = `regressor` @ parameters + friction; rows sorted by run, joint, time.

    Attributes:
        arm: n joints, n_el friction elements.
        runs: at their full rate.
        base: what the columns of the regressor mean.
        run: number of each row's run, shape (r,).
        joint: number of its joint, shape (r,).
        sample: its sample in the run, shape (r,).
        place: its place among the run's filtered samples, shape (r,).
        time: s, shape (r,).
        torque: filtered, Nm, shape (r,).
        regressor: filtered columns of the b base parameters, shape (r, b).
        reversal: rows at which an element that acts on the joint passes through rest, shape (r,).
    """

    arm: RigidArm
    runs: tuple[FilteredRun, ...]
    base: BaseGroups
    run: Index
    joint: Index
    sample: Index
    place: Index
    time: Array
    torque: Array
    regressor: Array
    reversal: Mask

    @classmethod
    def of(cls, arm: RigidArm, runs: Sequence[FilteredRun], springs: Sequence[str] | None = None) -> ExcitationProblem:
        """Stack the equations of runs.

        Args:
            arm: kinematics, couplings and elements.
            runs: of this arm.
            springs: joints with a spring; by default those on which the arm's description has one.

        Raises:
            IdentificationError: for runs of other joints, and if no joint moves.
        """
        _check_runs(arm, runs)
        there = [name for name, k in zip(arm.names, arm.spring.tolist(), strict=True) if k]
        columns = StandardColumns.with_springs_on(arm, there if springs is None else springs)
        base = BaseGroups.of(columns)
        parts = [_RunRows.of(number, run, columns, base) for number, run in enumerate(runs)]
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
        if not len(joined["run"]):
            raise IdentificationError("no joint moves in any run; accepted: runs in which the joints move")
        return cls(arm, tuple(runs), base, **joined)

    def __len__(self) -> int:
        return len(self.torque)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the columns, shape (b,)."""
        return self.base.names

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

    def _gathered(self, rows_of: Callable[[int, Index], Array]) -> Array:
        """Return rows that are made run by run."""
        return np.concatenate([rows_of(k, np.flatnonzero(self.run == k)) for k in range(len(self.runs))])


@dataclass(frozen=True, eq=False)
class _RunRows:
    """The rows of one run; attributes as in the problem."""

    run: Index
    joint: Index
    sample: Index
    place: Index
    time: Array
    torque: Array
    regressor: Array
    reversal: Mask

    @classmethod
    def of(cls, number: int, run: FilteredRun, columns: StandardColumns, base: BaseGroups) -> _RunRows:
        state = element_states(run, columns.arm.element_matrix)
        acts = columns.arm.element_matrix.T != 0.0
        rests = (state == SlidingState.RESTS) @ acts.T
        passes = (state == SlidingState.PASSES) @ acts.T
        joint, place = np.nonzero(~rests.T)
        torque, sample = run.parallel(run.torque), run.rows[place]
        regressor = np.zeros((len(joint), len(base.leading)))
        for samples, rows in run.blocks():
            values = columns.torque(*(values[samples] for values in (run.position, run.velocity, run.acceleration)))
            filtered = run.parallel(values[:, :, list(base.leading)])
            here = np.flatnonzero((place >= rows.start) & (place < rows.stop))
            regressor[here] = filtered[place[here] - rows.start, joint[here]]
        return cls(
            run=np.full(len(joint), number, dtype=np.intp),
            joint=joint,
            sample=sample,
            place=place,
            time=run.time[sample],
            torque=torque[place, joint],
            regressor=regressor,
            reversal=passes[place, joint],
        )


def _check_runs(arm: RigidArm, runs: Sequence[FilteredRun]) -> None:
    if not runs:
        raise IdentificationError("no excitation run; accepted: one or more")
    for run in runs:
        if run.names != arm.names:
            raise IdentificationError(
                f"{run.source.path}: joints {', '.join(run.names)}; accepted: {', '.join(arm.names)}"
            )
