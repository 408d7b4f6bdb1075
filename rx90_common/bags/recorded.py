"""Further content of a bag: robot, parameters, trajectories; and the alignment of two bags."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from rx90_common.bags.mapping import is_table
from rx90_common.bags.reading import BagReader, JointBag
from rx90_common.bags.topics import JOINT_TRAJECTORY, STRING, reports_changes
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import message_time_ns
from rx90_common.description.urdf import robot_name
from rx90_common.exchange.topics import TRAJECTORY_ACCEPTED

START: Final = "start"
TRAJECTORY: Final = "trajectory"

_DESCRIPTION = "robot_description"
_VALUES = (
    "", "bool", "integer", "double", "string",
    "byte_array", "bool_array", "integer_array", "double_array", "string_array",
)  # fmt: skip
"""The fields of a rcl_interfaces/ParameterValue by its type, without the ending."""


def check_robot(path: Path | str, robot: str) -> None:
    """Check that a bag is of a robot: that the first description in it, if there is one, bears its name."""
    if is_table(Path(path)):
        return
    with BagReader(path) as bag:
        topics = [t for t in bag.topics if t.msgtype == STRING and t.name.rpartition("/")[2] == _DESCRIPTION]
        for topic, _, data in islice(bag.messages(topics), 1):
            with suppress(ET.ParseError, ValueError):
                name = robot_name(str(bag.deserialize(topic, data).data))
                if name not in ("", robot):
                    raise BagError(
                        f"{plain(path)}: recorded of the robot {quoted(name)}, not of {quoted(robot)}; accepted: a "
                        "bag of that robot, or --robot with the bag's"
                    )


def read_changes(path: Path | str) -> list[str]:
    """Return the names of the parameters that were changed while a bag was recorded, in the order of its messages."""
    return [changed.name for event in _events(path) for changed in event.changed_parameters]


def read_values(path: Path | str) -> dict[str, Any]:
    """Return the parameters in a bag at the start of its nodes, by their names: numbers, lists of these, ..."""
    return {new.name: _value(new.value) for event in _events(path) for new in event.new_parameters}


def _events(path: Path | str) -> list[Any]:
    with BagReader(path) as bag:
        topics = [topic for topic in bag.topics if reports_changes(topic.name, topic.msgtype)]
        return [bag.deserialize(topic, data) for topic, _, data in bag.messages(topics)]


def _value(value: Any) -> Any:
    """Return what a rcl_interfaces/ParameterValue holds, None for nothing."""
    held = getattr(value, f"{_VALUES[value.type]}_value") if 0 < value.type < len(_VALUES) else None
    return held.tolist() if isinstance(held, np.ndarray) else held


@dataclass(frozen=True)
class RecordedTrajectory:
    """A trajectory that a controller took.

    Attributes:
        start_ns: when it starts.
        message: the JointTrajectory; without points the arm was to stop.
    """

    start_ns: int
    message: Any


def read_trajectories(path: Path | str) -> list[RecordedTrajectory]:
    """Return the trajectories of a bag in the order of their start.

    They are those of the controller's topic `trajectory_accepted`, whose stamps are start times.
    """
    with BagReader(path) as bag:
        kind = [topic for topic in bag.topics if topic.msgtype == JOINT_TRAJECTORY]
        fitting = [topic for topic in kind if topic.name.rpartition("/")[2] == TRAJECTORY_ACCEPTED]
        if len(fitting) > 1:
            what = f"has the trajectories of several controllers, {listed(sorted(topic.name for topic in fitting))}"
            raise BagError(f"{plain(path)}: {what}; accepted: those of one")
        if not fitting or not fitting[0].count:
            raise BagError(
                f"{plain(path)}: no trajectory in it; accepted: a bag with rx90_controller/{TRAJECTORY_ACCEPTED}, "
                "which rx90 bag record and rx90 run write"
            )
        found = [bag.deserialize(topic, data) for topic, _, data in bag.messages(fitting)]
    trajectories = [RecordedTrajectory(message_time_ns(m.header.stamp), m) for m in found]
    return sorted(trajectories, key=lambda one: one.start_ns)


def time_shift(align: int | str, first: JointBag, second: JointBag) -> int:
    """Return the offset to add to the stamps of the second of two bags, ns; `align` as in `Scope`."""
    if isinstance(align, int):
        return align
    if align == TRAJECTORY:
        return read_trajectories(first.path)[-1].start_ns - read_trajectories(second.path)[-1].start_ns
    return first.begin_ns - second.begin_ns
