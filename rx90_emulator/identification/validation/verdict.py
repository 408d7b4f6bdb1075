"""Recorded and predicted torques of bags, and the verdict: each quantity with its joint, value and limit.

Joints are compared while they move: the torque of a joint at rest depends on vibrations that no bag shows. Rows at
reversals, where a bristle's torque has not settled, can be looked at apart: they judge bristles, which are often
assumed, and the others judge all else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.options import ValidationTolerances
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.rows.excitation import ExcitationProblem


@dataclass(frozen=True, eq=False)
class TorquePrediction:
    """Recorded and predicted drive torques of n joints through the same low-pass.

    Attributes:
        time: s, shape (m,).
        recorded: Nm, shape (m, n).
        predicted: Nm, shape (m, n).
        compared: where a joint moves, shape (m, n).
    """

    time: Array
    recorded: Array
    predicted: Array
    compared: Mask

    @cached_property
    def difference(self) -> Array:
        """Return predicted less recorded torque where a joint moves, Nm, shape (m, n); NaN elsewhere."""
        return np.where(self.compared, self.predicted - self.recorded, np.nan)

    @property
    def rms(self) -> Array:
        """Return the RMS difference where a joint moves, Nm, shape (n,); NaN for a joint at rest."""
        return self._rms(self.predicted - self.recorded)

    @property
    def worst(self) -> Array:
        """Return the largest difference where a joint moves, Nm, shape (n,); NaN for a joint at rest."""
        return np.asarray(np.fmax.reduce(np.abs(self.difference), axis=0))

    @property
    def rms_share(self) -> Array:
        """Return the RMS difference over the RMS recorded torque, shape (n,): infinite where none was recorded."""
        with np.errstate(divide="ignore"):
            return self.rms / self._rms(self.recorded)

    @property
    def worst_share(self) -> Array:
        """Return the largest difference over the largest recorded torque, shape (n,): infinite where none was."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.worst / np.abs(self.recorded).max(axis=0))

    @property
    def total_share(self) -> float:
        """Return the RMS difference of all joints over their RMS recorded torque; NaN if nothing is compared."""
        recorded = float(np.linalg.norm(np.where(self.compared, self.recorded, 0.0)))
        difference = float(np.linalg.norm(np.nan_to_num(self.difference)))
        return difference / recorded if recorded else np.nan

    def _rms(self, values: Array) -> Array:
        count = self.compared.sum(axis=0)
        squares = np.where(self.compared, values, 0.0) ** 2
        return np.asarray(np.sqrt(squares.sum(axis=0) / np.where(count, count, np.nan)))


@dataclass(frozen=True, eq=False)
class RunTorques(TorquePrediction):
    """Recorded and predicted torques of one bag.

    Attributes:
        names: n joints.
        source: the bag.
        reversal: where an element that acts on a joint passes through rest, shape (m, n).
    """

    names: tuple[str, ...]
    source: BagSource
    reversal: Mask

    def variation(self, values: Array) -> Array:
        """Return the squares of values less their mean where each joint moves, in sum, shape (n,)."""
        moving = [column[there] for column, there in zip(values.T, self.compared.T, strict=True)]
        return np.array([column.size * np.var(column) if column.size else 0.0 for column in moving])

    @property
    def away_from_reversals(self) -> RunTorques:
        """Return the same, compared away from reversals alone."""
        return replace(self, compared=self.compared & ~self.reversal)

    @property
    def at_reversals(self) -> RunTorques:
        """Return the same, compared at reversals alone."""
        return replace(self, compared=self.compared & self.reversal)


def run_torques(problem: ExcitationProblem, predicted: Array) -> tuple[RunTorques, ...]:
    """Return the torques of each bag of a problem, for its identified joints; pieces of a bag are joined.

    Args:
        problem: r rows.
        predicted: torque of each, Nm, shape (r,).
    """
    runs = problem.runs
    identified = problem.arm.identified
    rows = (problem.sample, problem.joint)
    time = np.concatenate([run.time[run.rows] for run in runs])
    recorded = problem.recorded
    expected = recorded.copy()
    expected[rows] = predicted
    compared = np.zeros(recorded.shape, dtype=np.bool_)
    compared[rows] = True
    reversal = np.zeros(recorded.shape, dtype=np.bool_)
    reversal[rows] = problem.reversal
    names = tuple(compress(problem.arm.names, identified))
    bag = np.repeat([str(run.source.path) for run in runs], [len(run.rows) for run in runs])
    sources = {str(run.source.path): run.source for run in runs}
    torques = []
    for path, source in sources.items():
        place = np.ix_(bag == path, identified)
        torques.append(
            RunTorques(
                time=time[bag == path],
                recorded=recorded[place],
                predicted=expected[place],
                compared=compared[place],
                reversal=reversal[place],
                names=names,
                source=source,
            )
        )
    return tuple(torques)


@dataclass(frozen=True)
class Criterion:
    """A quantity of a verdict.

    Attributes:
        quantity: in words.
        value: its largest value, NaN if it is not compared.
        limit: up to which it agrees.
        joint: joint with the value; "" for a quantity of the whole arm.
        unit: of the text: %, mrad or µm.
        digits: after the decimal point.
    """

    quantity: str
    value: float
    limit: float
    joint: str = ""
    unit: str = "%"
    digits: int = 2

    @property
    def passed(self) -> bool:
        """Return whether it agrees."""
        return not self.value > self.limit

    @property
    def parts(self) -> tuple[str, str, str]:
        """Return quantity, value, and joint with limit: "torque RMS", "0.13%" and "(joint_6, limit 5%)"."""
        scale, unit, after = {
            "%": (1e2, "%", "%"),
            "mrad": (1e3, " mrad", ""),
            "µm": (1e6, " µm", ""),
        }[self.unit]
        whose = f"{self.joint}, " if self.joint else ""
        figure = f"{scale * self.value:.{self.digits}f}{unit}"
        return self.quantity, figure, f"({whose}limit {scale * self.limit:g}{after})"

    @property
    def text(self) -> str:
        """Return the parts in one."""
        return " ".join(self.parts)


def largest(
    quantity: str,
    names: Sequence[str],
    values: Array,
    limit: float,
    unit: str = "%",
    digits: int = 2,
) -> Criterion:
    """Return the criterion of the joint with the largest value; NaN means that a joint is not compared."""
    joint = int(np.argmax(np.nan_to_num(values, nan=-1.0)))
    return Criterion(quantity, float(values[joint]), limit, names[joint], unit, digits)


def torque_criteria(
    torque: RunTorques, limits: ValidationTolerances, by: str = ""
) -> tuple[Criterion, Criterion]:
    """Return the criteria of every verdict on torques: RMS difference over RMS torque of all joints, and of each.

    Args:
        torque: recorded and predicted.
        limits: for agreement.
        by: suffix of the quantity, such as " by the files".
    """
    all_joints = Criterion(f"torque RMS of all joints{by}", torque.total_share, limits.total)
    joint = largest(f"torque RMS of a joint{by}", torque.names, torque.rms_share, limits.torque)
    return all_joints, joint


def verdict(
    source: object,
    words: tuple[str, str],
    criteria: Sequence[Criterion],
    remarks: Sequence[str] = (),
) -> str:
    """Return one sentence: the bag, the verdict in the first or the second words, and the decisive criteria.

    Exceeded limits come first, because they decide.
    """
    failed = [criterion.text for criterion in criteria if not criterion.passed]
    kept = [criterion.text for criterion in criteria if criterion.passed]
    if not failed:
        return f"{source}: {words[0]}: {'; '.join([', '.join(kept), *remarks])}"
    within = [f"within the limits {', '.join(kept)}"] if kept else []
    return f"{source}: {words[1]}: {'; '.join([', '.join(failed), *within, *remarks])}"
