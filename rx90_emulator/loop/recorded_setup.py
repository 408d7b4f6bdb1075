"""What a bag tells of the setup: the robot, parameters of the nodes at the start, and what was changed meanwhile."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.reading import BagReader, read_joint_bag
from rx90_common.bags.topics import STRING, reports_changes
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.urdf import robot_name
from rx90_common.exchange.topics import REFERENCE

_DESCRIPTION = "robot_description"
_AT_REST = 2.5e-4  # rad/s

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
        topics = [
            t
            for t in bag.topics
            if t.msgtype == STRING and t.name.rpartition("/")[2] == _DESCRIPTION
        ]
        for topic, _, data in islice(bag.messages(topics), 1):
            with suppress(ET.ParseError, ValueError):
                name = robot_name(str(bag.deserialize(topic, data).data))
                if name not in ("", robot):
                    raise BagError(
                        f"recorded of the robot {quoted(name)}, not of {quoted(robot)}; accepted: a "
                        "bag of that robot, or --robot with the bag's"
                    )


def ends_in_motion(path: Path | str, mapping: LogMapping | None = None) -> bool:
    """Tell whether set-points in a bag still move at the end of the recording."""
    with BagReader(path, mapping) as bag:
        topics = [topic.name for topic in bag.topics if topic.name.endswith(f"/{REFERENCE}")]
    recorded = read_joint_bag(path, topics, mapping=mapping).series.values()
    return any(
        np.ptp(series.position[-2:], axis=0).max()
        > _AT_REST * np.ptp(series.stamp_ns[-2:]) / NANOSECONDS
        for sets in recorded
        for series in sets
        if series.position is not None
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
