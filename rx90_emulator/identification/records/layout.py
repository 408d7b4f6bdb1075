"""What the JointState messages of a bag hold: whose positions, on which side of the gears, in which unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias, TypeVar

import numpy as np

from rx90_common.bags.mapping import MESSAGE_KEYS, LogMapping, is_table, mapping_of
from rx90_common.bags.reading import BagReader
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES
from rx90_emulator.identification.model.options import RobotOptions
from rx90_emulator.identification.validation.options import MeasuredLayout
from rx90_emulator.loop.setup import Setup

JOINT_STATES = "joint_states"


@dataclass(frozen=True, eq=False)
class BagLayout:
    """What the JointState messages of a bag hold.

    Attributes:
        topic: topic name; the leading slash may be left out.
        messages: names in the messages, one for each joint or motor, from base to tip.
        names: the joints' names in the record, shape n.
        turns: motor turns for joint turns, gears included, shape (n, n), where the messages hold motor-side
            values: motor position = turns @ joint position, joint torque = turns^T @ motor torque. None where
            they hold joint-side values.
        torque_constant: torque per unit of effort on the messages' side, shape (n,), where effort is a current, A.
        record_time: whether the times of recording are taken for the stamps.
        zero: joint angle by the messages where that of the URDF is 0, rad, shape (n,); None for 0.
        mapping: what the columns of a table hold, where that is not in the file beside it.

    Raises:
        IdentificationError: if a size does not fit, a name stands twice or `turns` is not invertible.
    """

    topic: str
    messages: tuple[str, ...]
    names: tuple[str, ...]
    turns: Array | None = None
    torque_constant: Array | None = None
    record_time: bool = False
    zero: Array | None = None
    mapping: LogMapping | None = None

    def __post_init__(self) -> None:
        n = len(self.names)
        if len(self.messages) != n or n == 0:
            raise IdentificationError(f"{len(self.messages)} names in the messages for {n} joints; accepted: one each")
        twice = [name for name in self.messages if self.messages.count(name) > 1]
        if twice:
            found = f"name {quoted(twice[0])} in the messages for two joints"
            raise IdentificationError(f"{found}; accepted: each name once")
        for field, shape in (("turns", (n, n)), ("torque_constant", (n,)), ("zero", (n,))):
            values = getattr(self, field)
            if values is not None and (np.shape(values) != shape or not np.isfinite(values).all()):
                raise IdentificationError(f"{field} has shape {np.shape(values)}; accepted: finite numbers, {shape}")
        if self.turns is not None and abs(np.linalg.det(self.turns)) < 1e-9:
            raise IdentificationError(f"gears times coupling: {self.turns.tolist()}; accepted: an invertible matrix")

    @classmethod
    def of(
        cls,
        topic: str,
        messages: Sequence[str],
        names: Sequence[str],
        gear: Array | None = None,
        coupling: Array | None = None,
        torque_constant: Array | None = None,
    ) -> BagLayout:
        """Return the layout of messages of joints, or of motors where their gears are given.

        Args:
            topic: topic name.
            messages: the joints' or the motors' names in the messages.
            names: the joints' names.
            gear: motor revolutions per joint revolution, shape (n,); None for messages of joints.
            coupling: as in RigidArm.from_urdf, shape (n, n).
            torque_constant: torque per current, Nm/A, where effort is a current.
        """
        if gear is None:
            return cls(topic, tuple(messages), tuple(names), None, torque_constant)
        turns = np.eye(len(names)) if coupling is None else np.asarray(coupling, dtype=np.float64)
        if np.shape(gear) != (len(names),) or turns.shape != (len(names), len(names)):
            raise IdentificationError(
                f"gear of shape {np.shape(gear)}, coupling of shape {turns.shape}; accepted: ({len(names)},) and square"
            )
        return cls(topic, tuple(messages), tuple(names), np.asarray(gear)[:, None] * turns, torque_constant)

    @classmethod
    def rx90(cls, topic: str, setup: Setup) -> BagLayout:
        """Return the layout of this project's motor_states or joint_states."""
        return arm_layout(topic, setup.robot.joint_names, NO_OPTIONS, lambda: setup.drives.gear)


MessageOptions: TypeAlias = RobotOptions | MeasuredLayout
Options = TypeVar("Options", RobotOptions, MeasuredLayout)
NO_OPTIONS: Final = MeasuredLayout()


def with_signals(options: Options, logs: Sequence[Path]) -> tuple[Options, LogMapping | None]:
    """Return options with what a signal map says of the messages, and the map if the options name one.

    Args:
        options: of a command.
        logs: bags and tables; where the options name no map, that beside a table says so, too.

    Raises:
        ConfigError: for a map that is not acceptable, one key in a map and among the options, and tables whose maps
            say different things of the arm.
        BagError: for a table without a map.
    """
    given = None if options.signals is None else LogMapping.load(Path(options.signals))
    maps = [mapping_of(log) for log in logs if is_table(log)] if given is None else [given]
    for one in maps[1:]:
        if one.messages != maps[0].messages:
            raise ConfigError(
                f"{plain(one.file)} says other things of the arm than {plain(maps[0].file)}; accepted: the same "
                f"{', '.join(MESSAGE_KEYS)}"
            )
    said = maps[0].messages if maps else {}
    for key in said:
        if getattr(options, key) not in (None, False):
            raise ConfigError(f"--{key.replace('_', '-')} beside {key} in {plain(maps[0].file)}; accepted: one of them")
    return replace(options, **said), given


def arm_layout(
    topic: str,
    joints: Sequence[str],
    options: MessageOptions,
    own_gear: Callable[[], Array],
    mapping: LogMapping | None = None,
) -> BagLayout:
    """Return the layout of a topic of an arm of this project's structure.

    Args:
        topic: topic name; that of motors has this project's names and gears where the options say nothing else.
        joints: the joints' names.
        options: what the messages hold where it is not as here.
        own_gear: returns the robot's gears.
        mapping: what the columns of a table hold.

    Raises:
        IdentificationError: for options of another size, and a coupling without gears.
    """
    n = len(joints)
    for name, size in (("names", n), ("gear", n), ("torque_constant", n), ("zero", n), ("coupling", n * n)):
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size}")
    motors = topic.rpartition("/")[2] == MOTOR_STATES
    gear = own_gear() if motors and options.gear is None else _array(options.gear)
    if gear is None and options.coupling is not None:
        raise IdentificationError("--coupling without --gear; accepted: for the motors' states, with their --gear")
    coupling = coupling_matrix() if options.coupling is None else np.reshape(options.coupling, (n, n))
    messages = options.names or (MOTOR_NAMES if motors else joints)
    layout = BagLayout.of(topic, messages, joints, gear, coupling, _array(options.torque_constant))
    return replace(layout, record_time=options.record_time, zero=_array(options.zero), mapping=mapping)


def _array(values: Sequence[float] | None) -> Array | None:
    return None if values is None else np.array(values, dtype=np.float64)


def topic_names(bag: Path, mapping: LogMapping | None = None) -> set[str]:
    """Return the absolute names of the topics of a bag or a table; that is not read for it.

    Raises:
        BagError: if the bag cannot be read, or the table has no map.
    """
    if is_table(bag):
        return set(map(absolute, mapping_of(bag, mapping).topics))
    with BagReader(bag) as reader:
        return {topic.name for topic in reader.topics}


def recorded_topic(bag: Path, topics: Sequence[str], mapping: LogMapping | None = None) -> str:
    """Return the first of this project's topics that a bag has; of a table with one topic this one.

    Args:
        bag: to be looked at.
        topics: motor_states and joint_states, the one that is preferred first.
        mapping: what the columns of a table hold.

    Raises:
        BagError: if the bag cannot be read.
        IdentificationError: if it holds neither.
    """
    there = topic_names(bag, mapping)
    if is_table(bag) and len(there) == 1:
        return there.pop()
    for topic in topics:
        if absolute(topic) in there:
            return topic
    raise IdentificationError(
        f"{bag}: neither {MOTOR_STATES} nor {JOINT_STATES}; there are {', '.join(sorted(there)) or 'no topics'}; "
        "accepted: --topic"
    )
