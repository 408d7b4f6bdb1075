"""Whether an arm can be simulated, and what a measured bag of it holds."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.bags.reading import BagReader
from rx90_common.bags.recorded import check_robot
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import listed
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import element_names
from rx90_emulator.identification.records.layout import BagLayout
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured.options import MeasuredLayout

_JOINTS = 6
_MOVABLE = ("revolute", "continuous", "prismatic", "planar", "floating")
OTHER_ARMS = (
    "the closed loop simulates arms of six joints whose motor 6 turns with joints 5 and 6; for the torque of another "
    "arm: rx90_identify --friction FILE --validation BAG --urdf URDF"
)


def simulated_setup(files: RobotFiles) -> Setup:
    """Return the setup of a robot's files; refuse an arm of another structure with what can be done for it.

    Raises:
        ConfigError: naming file and what is accepted.
    """
    for role in ("drives", "controller"):
        path: Path = getattr(files, role)
        if not path.is_file():
            raise ConfigError(f"{path.parent}: no {FILES[role]}; {OTHER_ARMS}")
    joints = _movable_joints(files.urdf)
    if joints is not None:
        if len(joints) != _JOINTS:
            raise ConfigError(f"{files.urdf}: {len(joints)} movable joints; {OTHER_ARMS}")
        wanted = element_names(joints)
        missing = [name for name in wanted if name not in FrictionFile.read(files.friction).elements]
        if missing:
            raise ConfigError(f"{files.friction}: no friction element {listed(missing)}; {OTHER_ARMS}")
    return Setup.load(files)


def _movable_joints(urdf: Path) -> tuple[str, ...] | None:
    """Return the names of the joints that move; None for what is no XML, which the setup's own refusal names."""
    try:
        root = ET.parse(urdf).getroot()
    except (ET.ParseError, OSError):
        return None
    return tuple(str(joint.get("name")) for joint in root.findall("joint") if joint.get("type") in _MOVABLE)


def bag_layout(bag: Path, setup: Setup, options: MeasuredLayout) -> BagLayout:
    """Return what to read of a bag.

    Raises:
        BagError: if the bag cannot be read, or is another robot's.
        IdentificationError: for options of another size, and a bag without states.
    """
    check_robot(bag, setup.robot.model.name)
    joints = setup.robot.joint_names
    topic = options.topic or _topic(bag)
    if options.names is None:
        _check_names(bag, topic, joints)
    motors = topic.strip("/") == MOTOR_STATES
    for name, size in (("names", 6), ("gear", 6), ("torque_constant", 6), ("zero", 6), ("coupling", 36)):
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size}")
    messages = tuple(options.names or (MOTOR_NAMES if motors else joints))
    constant = _array(options.torque_constant)
    gear = _array(options.gear) if options.gear is not None or not motors else setup.drives.gear
    if gear is None:
        if options.coupling is not None:
            raise IdentificationError("--coupling without --gear; accepted: for the motors' states, with their --gear")
        layout = BagLayout(topic, messages, joints, None, constant)
    else:
        coupling = coupling_matrix() if options.coupling is None else np.reshape(options.coupling, (6, 6))
        layout = BagLayout.motor_side(topic, messages, joints, gear, coupling, constant)
    return replace(layout, record_time=options.record_time, zero=_array(options.zero))


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values, dtype=np.float64)


def _topic(bag: Path) -> str:
    with BagReader(bag) as reader:
        there = {topic.name for topic in reader.topics}
    for topic in (MOTOR_STATES, "joint_states"):
        if absolute(topic) in there:
            return topic
    raise IdentificationError(
        f"{bag}: neither {MOTOR_STATES} nor joint_states; there are {', '.join(sorted(there)) or 'no topics'}; "
        "accepted: --topic"
    )


def _check_names(bag: Path, topic: str, joints: Sequence[str]) -> None:
    """Refuse a bag whose first message names none of this arm's joints or motors: another arm's."""
    with BagReader(bag) as reader:
        there = [one for one in reader.topics if one.name == absolute(topic) and one.is_joint_state]
        first = next(reader.messages(there), None) if there else None
        names = [str(name) for name in reader.deserialize(first[0], first[2]).name] if first else []
    if names and not {*names} & {*joints, *MOTOR_NAMES}:
        raise IdentificationError(
            f"{bag}: {topic} is of {listed(names)}; accepted: {listed(joints)}, or --names; {OTHER_ARMS}"
        )
