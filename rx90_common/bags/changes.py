"""Parameters that were changed while nodes ran, as a bag tells them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.storage import BagReader
from rx90_common.bags.topics import tells_changes
from rx90_common.base.stamps import message_time_ns

_VALUES = (
    "", "bool", "integer", "double", "string",
    "byte_array", "bool_array", "integer_array", "double_array", "string_array",
)  # fmt: skip
"""The fields of a rcl_interfaces/ParameterValue by its type, without the ending."""


@dataclass(frozen=True)
class ParameterChange:
    """A parameter of a node that was changed while it ran; it counts from this stamp on. The value is JSON."""

    node: str
    name: str
    value: str
    stamp_ns: int


def changes_of(event: Any) -> list[ParameterChange]:
    """Return what a rcl_interfaces/ParameterEvent tells."""
    stamp = message_time_ns(event.stamp)
    return [ParameterChange(event.node, each.name, _value(each.value), stamp) for each in event.changed_parameters]


def read_changes(path: Path | str) -> list[ParameterChange]:
    """Return the changes that a bag tells, in the order of its messages.

    Raises:
        BagError: if the bag cannot be read.
    """
    return [change for event in _events(path) for change in changes_of(event)]


def read_values(path: Path | str) -> dict[str, Any]:
    """Return the values that a bag tells of parameters as its nodes began, by their names: numbers, lists of these, ...

    Raises:
        BagError: if the bag cannot be read.
    """
    told = [event for event in _events(path) if len(event.new_parameters)]
    return {each.name: json.loads(_value(each.value)) for event in told for each in event.new_parameters}


def _events(path: Path | str) -> list[Any]:
    with BagReader(path) as bag:
        topics = [topic for topic in bag.topics if tells_changes(topic.name, topic.msgtype)]
        return [bag.deserialize(topic, data) for topic, _, data in bag.messages(topics)] if topics else []


def _value(value: Any) -> str:
    """Return what a rcl_interfaces/ParameterValue holds as JSON, null for nothing."""
    held = getattr(value, f"{_VALUES[value.type]}_value") if 0 < value.type < len(_VALUES) else None
    return json.dumps(held.tolist() if isinstance(held, np.ndarray) else held)
