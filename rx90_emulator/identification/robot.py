"""The robot that bags come from, this project's or any other, and the contents of its logs' messages.

Names, side of the gears and units of the values are stated once, by the options of a command or by a signal map, for
bags and tables alike: `arm_layout` makes one layout of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rx90_common.bags.mapping import MESSAGE_KEYS, LogMapping, is_table, mapping_of
from rx90_common.bags.reading import BagReader
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import counted, plain, quoted
from rx90_common.base.share import resolve_config
from rx90_common.description.drives import DriveParameters
from rx90_common.description.joint_model import movable_joints
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_STATES, motor_names
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile, refuse_parts
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import SHIPPED_ROBOT, MeasuredLayout, RobotOptions
from rx90_emulator.loop.recorded_setup import check_robot
from rx90_emulator.loop.setup import Setup

JOINT_STATES = "joint_states"
Options = TypeVar("Options", bound=MeasuredLayout)
NO_OPTIONS = MeasuredLayout()
_ONE_EACH = ("names", "gear", "torque_constant", "zero", "rotor_inertia", "spring")


@dataclass(frozen=True, eq=False)
class BagLayout:
    """The contents of the JointState messages of a bag or a table.

    Attributes:
        topic: topic name; the leading slash may be left out.
        messages: names in the messages, one for each of n joints or motors, from base to tip.
        names: the joints' names in the record, n of them.
        turns: motor turns for joint turns, gears included, shape (n, n), if the messages contain motor-side values:
            motor position = turns @ joint position, joint torque = turns^T @ motor torque. None for joint-side values.
        torque_constant: torque per unit of effort on the messages' side, shape (n,), if effort is a current, A.
        record_time: whether the times of recording are used instead of the stamps.
        zero: recorded joint angle in the zero pose of the URDF, rad, shape (n,); None for 0.
        mapping: the columns of a table, if the file beside it does not state them.
        followed: further joints, by their names in the messages and in the record: positions alone, joint side.
        torque_delay: by how much the torques acted later than their stamps say, s.
    """

    topic: str
    messages: tuple[str, ...]
    names: tuple[str, ...]
    turns: Array | None = None
    torque_constant: Array | None = None
    record_time: bool = False
    zero: Array | None = None
    mapping: LogMapping | None = None
    followed: tuple[str, ...] = ()
    torque_delay: float = 0.0

    def __post_init__(self) -> None:
        twice = [name for name in self.messages if self.messages.count(name) > 1]
        if twice:
            raise IdentificationError(
                f"name {quoted(twice[0])} in the messages for two joints; accepted: each name once"
            )
        if self.turns is not None and abs(np.linalg.det(self.turns)) < 1e-9:
            raise IdentificationError(
                f"gears times coupling: {self.turns.tolist()}; accepted: an invertible matrix"
            )

    def joint_side(self, fields: Mapping[str, Array]) -> dict[str, Array]:
        """Return position, rad, velocity, rad/s, and effort, Nm, of the joints, as far as the messages contain them."""
        values = dict(fields)
        if self.torque_constant is not None and "effort" in values:
            values["effort"] = values["effort"] * self.torque_constant
        if self.turns is not None:
            inverse = np.linalg.inv(self.turns).T
            values = {
                name: column @ (self.turns if name == "effort" else inverse)
                for name, column in values.items()
            }
        if self.zero is not None:
            values["position"] = values["position"] - self.zero
        return values


def with_signals(options: Options, logs: Sequence[Path]) -> tuple[Options, LogMapping | None]:
    """Return options with the statements of a signal map, and the map if the options name one.

    Args:
        options: of a command.
        logs: bags and tables; if the options name no map, the one beside a table is used.
    """
    given = None if options.signals is None else LogMapping.load(Path(options.signals))
    maps = [mapping_of(log) for log in logs if is_table(log)] if given is None else [given]
    for further in maps[1:]:
        if further.messages != maps[0].messages:
            raise ConfigError(
                f"{plain(further.path)} says other things of the arm than {plain(maps[0].path)}; accepted: the same "
                f"{', '.join(MESSAGE_KEYS)}"
            )
    mapped = maps[0].messages if maps else {}
    for key in mapped:
        if not hasattr(options, key):
            raise ConfigError(
                f"{plain(maps[0].path)}: {key} is of no use here; accepted: without it"
            )
        if getattr(options, key) not in (None, False):
            raise ConfigError(
                f"{_option(key)} beside {key} in {plain(maps[0].path)}; accepted: one of them"
            )
    return replace(options, **mapped), given


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _check_sizes(options: MeasuredLayout, joints: int) -> None:
    """Refuse options with another size than for the joints, and numbers that are not finite."""
    for name in (*_ONE_EACH, "coupling"):
        values = getattr(options, name, None)
        size = joints**2 if name == "coupling" else joints
        if values is None:
            continue
        if len(values) != size:
            given = counted(len(values), "value")
            raise IdentificationError(
                f"{_option(name)}: {given}; accepted: {size} for {counted(joints, 'joint')}"
            )
        if name == "names":
            continue
        if not np.isfinite(values).all() or (name == "rotor_inertia" and min(values) < 0.0):
            raise IdentificationError(
                f"{_option(name)}: {list(values)}; accepted: finite numbers, inertias of 0 or more"
            )


def arm_layout(
    topic: str,
    joints: Sequence[str],
    options: MeasuredLayout = NO_OPTIONS,
    own_drives: Callable[[], DriveParameters] | None = None,
    mapping: LogMapping | None = None,
) -> BagLayout:
    """Return the layout of a topic of an arm.

    Args:
        topic: topic name; that of motors has this project's names, gears and coupling unless the options state others.
        joints: the joints' names.
        options: deviations of the messages from these conventions.
        own_drives: returns the drives of a robot of this project; None for another robot.
        mapping: the columns of a table.
    """
    n = len(joints)
    _check_sizes(options, n)
    motors = own_drives is not None and topic.rpartition("/")[2] == MOTOR_STATES
    gear = _array(options.gear)
    usual = np.eye(n)
    if own_drives is not None:
        if motors and gear is None:
            gear = own_drives().gear
        if gear is not None:
            usual = own_drives().turning.turns
        elif options.coupling is not None:
            raise IdentificationError(
                "coupling without gears; accepted: for the motors' states, with their --gear"
            )
    coupling = usual if options.coupling is None else np.reshape(options.coupling, (n, n))
    return BagLayout(
        topic=topic,
        messages=tuple(options.names or (motor_names(n) if motors else joints)),
        names=tuple(joints),
        turns=None if gear is None else gear[:, None] * coupling,
        torque_constant=_array(options.torque_constant),
        record_time=options.record_time,
        zero=_array(options.zero),
        mapping=mapping,
        torque_delay=options.torque_delay if isinstance(options, RobotOptions) else 0.0,
    )


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values, dtype=np.float64)


def topic_names(bag: Path, mapping: LogMapping | None = None) -> set[str]:
    """Return the absolute names of the topics of a bag or a table, without reading the table."""
    if is_table(bag):
        return set(map(absolute, mapping_of(bag, mapping).by_topic))
    with BagReader(bag) as reader:
        return {topic.name for topic in reader.topics}


def recorded_topic(bag: Path, topics: Sequence[str], mapping: LogMapping | None = None) -> str:
    """Return the first of this project's topics that a bag has; or that of a table.

    Args:
        bag: the bag or table.
        topics: motor_states and joint_states, the preferred one first.
        mapping: the columns of a table.
    """
    there = topic_names(bag, mapping)
    if is_table(bag) and len(there) == 1:
        return there.pop()
    for topic in topics:
        if absolute(topic) in there:
            return topic
    missing = (
        f"neither {MOTOR_STATES} nor {JOINT_STATES}"
        if len(topics) > 1
        else f"no topic {plain(topics[0])}"
    )
    raise IdentificationError(
        f"{bag}: {missing}; there are {', '.join(sorted(there)) or 'no topics'}; accepted: --topic"
    )


def message_names(log: Path, topic: str, mapping: LogMapping | None = None) -> tuple[str, ...]:
    """Return the names in the first message of a JointState topic of a bag, or those of a table."""
    if is_table(log):
        columns = {
            absolute(name): part.names or ()
            for name, part in mapping_of(log, mapping).by_topic.items()
        }
        return columns.get(absolute(topic), ())
    with BagReader(log) as reader:
        there = [
            entry
            for entry in reader.topics
            if entry.name == absolute(topic) and entry.is_joint_state
        ]
        first = next(reader.messages(there), None) if there else None
        return (
            ()
            if first is None
            else tuple(str(name) for name in reader.deserialize(first[0], first[2]).name)
        )


def _of_joints(options: RobotOptions) -> RobotOptions:
    """Return options for the joints of interest alone, if a map states names, gears and so on of more joints."""
    names = list(options.names or ())
    joints = options.joints
    if joints is None or len(names) <= len(joints) or not set(joints) <= set(names):
        return options
    place = [names.index(joint) for joint in joints]
    chosen: dict[str, Any] = {}
    for key in ("names", "gear", "torque_constant", "zero"):
        values = getattr(options, key)
        if values is not None and len(values) == len(names):
            chosen[key] = [values[k] for k in place]
    return replace(options, **chosen)


def _followed(
    urdf: Path,
    arm: RigidArm,
    options: RobotOptions,
    logs: Sequence[Path],
    mapping: LogMapping | None,
) -> tuple[str, ...]:
    """Return the joints that all logs contain besides an arm's, and whose motion affects it."""
    topic = options.topic or JOINT_STATES
    there = set(movable_joints(urdf)) if logs else set()
    for log in logs:
        there &= set(
            message_names(
                log, recorded_topic(log, (topic,), mapping) if is_table(log) else topic, mapping
            )
        )
    others = there - {*arm.names, *(options.names or ())}
    if not others:
        return ()
    everything = RigidArm.from_urdf(urdf, options.joints, massless=True, followed=sorted(others))
    return tuple(name for name in everything.related() if name in others)


@dataclass(frozen=True, eq=False)
class RecordedRobot:
    """The robot that bags come from.

    Attributes:
        arm: rigid-body model and friction elements.
        setup: for the closed loop; None for another robot than this project's.
        options: deviations of the messages from this project's conventions, signal maps included.
        fallback: elements whose values replace parameters that are not identifiable, and whose omega_d is used; None
            to assume them.
        fallback_name: their file.
        mapping: the columns of tables, if the files beside them do not state them.
        held: joints in the logs without a known gear, so that their motion is not known: they are fixed at 0.
    """

    arm: RigidArm
    setup: Setup | None = None
    options: RobotOptions = SHIPPED_ROBOT
    fallback: tuple[FrictionElement, ...] | None = None
    fallback_name: str | None = None
    mapping: LogMapping | None = None
    held: tuple[str, ...] = ()

    @classmethod
    def load(
        cls,
        options: RobotOptions,
        logs: Sequence[Path] = (),
        *,
        massless: bool = False,
        follow: bool = False,
    ) -> RecordedRobot:
        """Return the robot that the options describe.

        Args:
            options: of the command.
            logs: bags and tables of the robot; maps beside tables count like options.
            massless: whether links without <inertial> are accepted, because only kinematics are needed.
            follow: whether joints of another robot that all logs contain, and that carry the joints of interest or are
                carried by them, follow the logs instead of being fixed at 0.
        """
        options, mapping = with_signals(options, logs)
        ours = options.urdf is None
        for name in ("joints", "rotor_inertia", "spring") if ours else ("robot", "tool", "drives"):
            if getattr(options, name) is not None:
                accepted = (
                    "with --urdf of another robot" if ours else "for this project's robot alone"
                )
                how = "without" if ours else "with"
                raise IdentificationError(f"{_option(name)} {how} --urdf; accepted: {accepted}")
        if options.urdf is None:
            files = RobotFiles.of_options(options)
            setup = Setup.load(files)
            arm = RigidArm.from_setup(setup)
            _check_sizes(options, len(arm.names))
            fallback, source = _fallback(arm, options.fallback or files.text("friction"))
            return cls(arm, setup, options, fallback, source, mapping)
        urdf = Path(options.urdf)
        options = _of_joints(options)
        arm = RigidArm.from_urdf(urdf, options.joints, massless=massless)
        # refused before any bag is read
        arm_layout(options.topic or JOINT_STATES, arm.names, options)
        others = _followed(urdf, arm, options, logs, mapping) if follow else ()
        # The gears of joints that follow are not known.
        followed = others if options.gear is None else ()
        held = () if options.gear is None else others
        coupling = (
            None if options.coupling is None else np.reshape(options.coupling, arm.coupling.shape)
        )
        drives = (coupling, options.rotor_inertia, options.spring)
        arm = RigidArm.from_urdf(
            urdf, options.joints, *drives, massless=massless, followed=followed
        )
        fallback, source = _fallback(arm, options.fallback or "none")
        return cls(arm, None, options, fallback, source, mapping, held)

    @property
    def zero(self) -> Array | None:
        """Return the recorded angle of each joint in the zero pose of its URDF, rad, shape (n,); None for 0."""
        given = _array(self.options.zero)
        if given is None:
            return None
        zero = np.zeros(len(self.arm.names))
        zero[self.arm.identified] = given
        return zero

    @property
    def followed(self) -> tuple[str, ...]:
        """Return the joints that are not identified and follow the logs."""
        return tuple(np.array(self.arm.names)[~self.arm.identified].tolist())

    def layout(self, bag: Path, *, fast: bool) -> BagLayout:
        """Return the layout of a bag: the motors' states if the rate matters and the bag contains them."""
        setup = self.setup
        topic = self.options.topic
        if setup is None:
            topic = topic or JOINT_STATES
            topic = recorded_topic(bag, (topic,), self.mapping) if is_table(bag) else topic
            joints = np.array(self.arm.names)[self.arm.identified].tolist()
            return replace(
                arm_layout(topic, joints, self.options, None, self.mapping), followed=self.followed
            )
        check_robot(bag, setup.robot.model.name)
        topics = (MOTOR_STATES, JOINT_STATES) if fast else (JOINT_STATES, MOTOR_STATES)
        topic = topic or recorded_topic(bag, topics, self.mapping)
        return arm_layout(topic, self.arm.names, self.options, lambda: setup.drives, self.mapping)


def _fallback(
    arm: RigidArm, name: str
) -> tuple[tuple[FrictionElement, ...], str] | tuple[None, None]:
    """Return an arm's elements by a friction file, and its name; nothing for none."""
    if name == "none":
        return None, None
    path = resolve_config(name)
    elements = FrictionFile.read(path).select(arm.element_names, path)
    named = dict(zip(arm.element_names, elements, strict=True))
    refuse_parts(named, "an identification with it as --fallback", f"{name}: elements.")
    return elements, name
