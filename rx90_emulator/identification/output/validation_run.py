"""Read a validation bag and hold the result against it."""

from __future__ import annotations

import numpy as np

from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.bags.topics import absolute
from rx90_emulator.identification.identify import Identification
from rx90_emulator.identification.output.validation import Validation, predict_torque, tip_difference
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.records.robot import Robot
from rx90_emulator.identification.records.tolerances import Tolerances

_REFERENCE = "rx90_controller/reference"


def validate(result: Identification, robot: Robot, record: JointRecord, tolerances: Tolerances) -> Validation:
    """Return the cross-check on a bag's record.

    The tip is only that of this project's robot, where the set-points are in the bag.

    Raises:
        Rx90Error: if the bag cannot be read or used.
    """
    bag = record.source
    time, recorded, predicted, compared = predict_torque(result, record)
    tip_time, distance = np.zeros(0), np.zeros(0)
    if robot.setup is not None:
        with BagReader(bag) as reader:
            there = any(topic.name == absolute(_REFERENCE) for topic in reader.topics)
        if there:
            reference = read_joint_states(bag, _REFERENCE, record.names)
            tip_time, distance = tip_difference(robot.setup, result.lugre, record, reference)
    return Validation(record.names, time, recorded, predicted, compared, tip_time, distance, tolerances, str(bag))
