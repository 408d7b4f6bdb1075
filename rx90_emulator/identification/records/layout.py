"""What the JointState messages of a bag hold: whose positions, on which side of the gears, in which unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90_common.bags.mapping import LogMapping, is_table, mapping_of
from rx90_common.bags.reading import BagReader
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES
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
        names = setup.robot.joint_names
        if topic == MOTOR_STATES:
            return cls.of(topic, MOTOR_NAMES, names, setup.drives.gear, coupling_matrix())
        return cls.of(topic, names, names)


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
    what = f"neither {MOTOR_STATES} nor {JOINT_STATES}" if len(topics) > 1 else f"no topic {plain(topics[0])}"
    raise IdentificationError(f"{bag}: {what}; there are {', '.join(sorted(there)) or 'no topics'}; accepted: --topic")
