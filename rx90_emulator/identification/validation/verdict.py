"""Recorded against predicted torques, and the verdict on them: each quantity with its joint, value and limit.

Joints are compared where they move: the torque of a joint at rest depends on vibrations that no bag shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, Mask


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
        """Return the RMS difference over the RMS recorded torque, shape (n,)."""
        return np.asarray(self.rms / self._rms(self.recorded))

    @property
    def worst_share(self) -> Array:
        """Return the largest difference over the largest recorded torque, shape (n,)."""
        return np.asarray(self.worst / np.abs(self.recorded).max(axis=0))

    @property
    def total_share(self) -> float:
        """Return the RMS difference of all joints over their RMS recorded torque."""
        both = self.predicted - self.recorded, self.recorded
        difference, recorded = (np.linalg.norm(np.where(self.compared, values, 0.0)) for values in both)
        return float(difference / recorded)

    def _rms(self, values: Array) -> Array:
        count = self.compared.sum(axis=0)
        squares = np.where(self.compared, values, 0.0) ** 2
        return np.asarray(np.sqrt(squares.sum(axis=0) / np.where(count, count, np.nan)))


@dataclass(frozen=True)
class Criterion:
    """A quantity that a verdict rests on.

    Attributes:
        quantity: in words.
        value: its largest value, NaN if it is not compared.
        limit: up to which it agrees.
        joint: that has the value; "" for a quantity of the whole arm.
        unit: of the text: %, mrad or um.
        digits: behind the point.
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
    def text(self) -> str:
        """Return quantity, value, joint and limit: "torque RMS 0.13% (joint_6, limit 5%)"."""
        scale, unit, after = {"%": (1e2, "%", "%"), "mrad": (1e3, " mrad", ""), "um": (1e6, " um", "")}[self.unit]
        whose = f"{self.joint}, " if self.joint else ""
        return (
            f"{self.quantity} {scale * self.value:.{self.digits}f}{unit} ({whose}limit {scale * self.limit:g}{after})"
        )


def largest(
    quantity: str, names: Sequence[str], values: Array, limit: float, unit: str = "%", digits: int = 2
) -> Criterion:
    """Return the criterion of the joint with the largest value; NaN stands for a joint that is not compared."""
    joint = int(np.argmax(np.nan_to_num(values, nan=-1.0)))
    return Criterion(quantity, float(values[joint]), limit, names[joint], unit, digits)


def torque_criteria(
    names: Sequence[str], total: float, share: Array, most: float, most_of_joint: float, by: str = ""
) -> tuple[Criterion, Criterion]:
    """Return what every verdict on torques rests on: RMS difference over RMS torque of all joints, and of each.

    Args:
        names: n joints.
        total: of all joints.
        share: of each, NaN where it is not compared, shape (n,).
        most: accepted of all joints.
        most_of_joint: accepted of a single one.
        by: behind the quantity, such as " by the files".
    """
    all_joints = Criterion(f"torque RMS of all joints{by}", total, most)
    return all_joints, largest(f"torque RMS of a joint{by}", names, share, most_of_joint)


def verdict(source: object, words: tuple[str, str], *parts: Criterion | str) -> str:
    """Return one sentence: the bag, the verdict in the first or the second words, and what decides.

    What is beyond its limit stands before all that is not: that decided.
    """
    failed, kept = ([one.text for one in parts if isinstance(one, Criterion) and one.passed is good]
                    for good in (False, True))  # fmt: skip
    said = [one for one in parts if isinstance(one, str)]
    if not failed:
        return f"{source}: {words[0]}: {'; '.join([', '.join(kept), *said])}"
    within = [f"within the limits {', '.join(kept)}"] if kept else []
    return f"{source}: {words[1]}: {'; '.join([', '.join(failed), *within, *said])}"
