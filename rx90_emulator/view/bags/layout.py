"""Which topic of a bag tells a robot's joint angles, and on which side of the gears."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rx90_common.bags.reading import BagReader, BagTopic
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.urdf import JOINT_COUNT
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES, SAMPLED
from rx90_emulator.identification.records.layout import BagLayout
from rx90_emulator.identification.validation.options import MeasuredLayout

_JOINT_STATES = "joint_states"
_ONCE_MORE = f"/{SAMPLED}/{_JOINT_STATES}"
_SIZES = dict.fromkeys(("names", "gear", "torque_constant", "zero"), JOINT_COUNT) | {"coupling": JOINT_COUNT**2}


def arm_layout(bag: BagReader, robot: RobotModel, files: RobotFiles, options: MeasuredLayout) -> BagLayout:
    """Return what to read of a bag; by default `joint_states` in any namespace, else `motor_states`.

    Raises:
        BagError: for a bag without joint angles, or with those of several arms, and options of another size.
        ConfigError: if the drives file is not acceptable, which is read for the gears of motors.
        IdentificationError: if gears and coupling do not fit together.
    """
    topic = _topic(bag, options.topic)
    for name, size in _SIZES.items():
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise BagError(f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size}")
    motors = topic.name.rpartition("/")[2] == MOTOR_STATES
    messages = tuple(options.names or (MOTOR_NAMES if motors else robot.joint_names))
    if options.gear is None and not motors:
        if options.coupling is not None:
            raise BagError("--coupling without --gear; accepted: for the motors' states, with their --gear")
        layout = BagLayout(topic.name, messages, robot.joint_names)
    else:
        gear = load_drives(files.drives).gear if options.gear is None else np.array(options.gear, dtype=np.float64)
        coupling = (
            coupling_matrix() if options.coupling is None else np.reshape(options.coupling, (JOINT_COUNT, JOINT_COUNT))
        )
        layout = BagLayout.motor_side(topic.name, messages, robot.joint_names, gear, coupling)
    return replace(
        layout, record_time=options.record_time, zero=_array(options.zero),
        torque_constant=_array(options.torque_constant),
    )  # fmt: skip


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values, dtype=np.float64)


def _topic(bag: BagReader, wanted: str | None) -> BagTopic:
    held = [topic for topic in bag.topics if topic.is_joint_state and topic.count]
    there = listed(topic.name for topic in held) or "none"
    if wanted is not None:
        fitting = [topic for topic in held if topic.name == absolute(wanted)]
    else:
        fitting = [topic for topic in held if topic.name.rpartition("/")[2] == _JOINT_STATES]
        # Of those recorded with what the simulation publishes once more for who looks on.
        fitting = [topic for topic in fitting if not topic.name.endswith(_ONCE_MORE)] or fitting
        fitting = fitting or [topic for topic in held if topic.name.rpartition("/")[2] == MOTOR_STATES]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        arms = listed(topic.name for topic in fitting)
        raise BagError(f"{plain(bag.path)}: holds the states of several arms, {arms}; accepted: --topic with one")
    what = f"no messages in {plain(absolute(wanted))}" if wanted else f"neither {_JOINT_STATES} nor {MOTOR_STATES}"
    raise BagError(f"{plain(bag.path)}: {what}; JointState topics with messages: {there}; accepted: --topic with one")
