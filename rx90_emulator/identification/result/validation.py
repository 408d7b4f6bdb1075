"""The verdict on a friction by a bag that was not used for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.model.options import ValidationTolerances
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.model.zeros import ZeroCheck
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.result.prediction import TorquePrediction, predict_torque, tip_difference
from rx90_emulator.identification.sliding.fit import SlidingFit
from rx90_emulator.identification.sliding.zeros import check_zeros, record_instants

_REFERENCE = "rx90_controller/reference"


@dataclass(frozen=True, eq=False)
class Validation:
    """Recorded against predicted torques, and the recorded tip against the simulated one.

    Joints are compared where they move: the torque of a joint at rest depends on vibrations that no bag shows.

    Attributes:
        names: joints, n of them.
        torque: recorded and predicted torques of the joints.
        tip_time: s, shape (k,); empty where the bag holds no set-points.
        tip_distance: of the simulated from the recorded tip, m, shape (k,).
        tolerances: what counts as agreement.
        source: the bag.
        zeros: what the torques say of the encoders' zeros, where a given friction is held against the bag.
    """

    names: tuple[str, ...]
    torque: TorquePrediction
    tip_time: Array
    tip_distance: Array
    tolerances: ValidationTolerances
    source: str
    zeros: ZeroCheck | None = None

    def _mean(self, values: Array) -> Array:
        compared = self.torque.compared
        return np.asarray((compared * values).sum(axis=0) / np.maximum(1.0, compared.sum(axis=0)))

    @property
    def rms(self) -> Array:
        """Return the RMS torque difference, Nm, shape (n,)."""
        return np.asarray(np.sqrt(self._mean((self.torque.predicted - self.torque.recorded) ** 2)))

    @property
    def worst(self) -> Array:
        """Return the largest torque difference, Nm, shape (n,)."""
        torque = self.torque
        return np.asarray((torque.compared * np.abs(torque.predicted - torque.recorded)).max(axis=0))

    @property
    def rms_share(self) -> Array:
        """Return the RMS difference over the RMS recorded torque, shape (n,)."""
        return np.asarray(self.rms / np.sqrt(self._mean(self.torque.recorded**2)))

    @property
    def worst_share(self) -> Array:
        """Return the largest difference over the largest recorded torque, shape (n,)."""
        return np.asarray(self.worst / np.abs(self.torque.recorded).max(axis=0))

    @property
    def tip_worst(self) -> float:
        """Return the largest distance of the tips, m; NaN without set-points."""
        return float(self.tip_distance.max()) if len(self.tip_distance) else float("nan")

    @property
    def tip_rms(self) -> float:
        """Return the RMS distance of the tips, m; NaN without set-points."""
        return float(np.sqrt(np.mean(self.tip_distance**2))) if len(self.tip_distance) else float("nan")

    @property
    def passed(self) -> bool:
        """Return whether everything that could be compared agrees."""
        limits = self.tolerances
        torque = bool((self.rms_share <= limits.torque).all() and (self.worst_share <= limits.worst_torque).all())
        return torque and not self.tip_worst > limits.tip


def validate(
    robot: RecordedRobot,
    lugre: tuple[FrictionElement, ...],
    sliding: SlidingFit | None,
    record: JointRecord,
    tolerances: ValidationTolerances,
) -> Validation:
    """Compare friction with a bag; the tip only for this project's robot, where set-points are in the bag.

    Args:
        robot: that the bag comes from.
        lugre: its friction elements.
        sliding: fit that they come from; None for elements that are given.
        record: what was read of the bag.
        tolerances: what counts as agreement.

    Raises:
        Rx90Error: if the bag cannot be read or used.
    """
    bag = record.source
    torque = predict_torque(robot.arm, lugre, sliding, record)
    tip_time, distance = np.zeros(0), np.zeros(0)
    if robot.setup is not None:
        with BagReader(bag) as reader:
            there = any(topic.name == absolute(_REFERENCE) for topic in reader.topics)
        if there:
            reference = read_joint_states(bag, _REFERENCE, record.names)
            if robot.zero is not None and reference.position is not None:
                reference = replace(reference, position=reference.position - robot.zero)
            tip_time, distance = tip_difference(robot.setup, lugre, record, reference)
    # With sweeps, these have been asked already.
    zeros = check_zeros(record_instants(record, robot.arm), robot.arm, robot.zero) if sliding is None else None
    return Validation(record.names, torque, tip_time, distance, tolerances, str(bag), zeros)
