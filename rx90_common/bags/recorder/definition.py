"""Definitions of message types as text, from the classes that rclpy has: for types that a reader may not know."""

from __future__ import annotations

import importlib
import re
from collections.abc import Collection
from typing import Any

from rx90_common.base.errors import BagError
from rx90_common.base.requirements import missing_module

_BASE = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
"""What .msg files call the types that the classes name as IDL does."""
_SEQUENCE = re.compile(r"sequence<(?P<kind>.+?)(, (?P<most>\d+))?>")
_ARRAY = re.compile(r"(?P<kind>.+)\[(?P<count>\d+)\]")
_STRING = re.compile(r"(?P<kind>w?string)<(?P<most>\d+)>")


def message_class(topic: str, msgtype: str) -> Any:
    """Return the class of a message type.

    Raises:
        BagError: if the type is not installed, with how to get it where that is known.
    """
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError as error:
        raise BagError(f"{topic} has type {msgtype}: {missing_module(error) or error}") from error
    except AttributeError as error:
        raise BagError(f"{topic} has type {msgtype}, which the {package} that is installed does not have") from error


def definition(kind: Any, known: Collection[str]) -> str:
    """Return the text of a message class, and of what it consists of, as rosbag2 puts it into bags.

    Constants, defaults and comments are not in it: messages do not carry them.

    Args:
        kind: the class.
        known: types whose text is not wanted.
    """
    texts: dict[str, str] = {}
    _collect(kind, frozenset(known), texts)
    own, *others = texts.items()
    return own[1] + "".join(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)


def begins_with_header(kind: Any) -> bool:
    """Return whether the first field of a message class is a std_msgs/Header."""
    return next(iter(kind.get_fields_and_field_types().values()), None) == "std_msgs/Header"


def _collect(kind: Any, known: frozenset[str], texts: dict[str, str]) -> None:
    package = kind.__module__.split(".")[0]
    name = f"{package}/{kind.__name__}"
    if name in texts:
        return
    fields = kind.get_fields_and_field_types()
    texts[name] = "".join(f"{_field_type(described)} {field}\n" for field, described in fields.items())
    for described in fields.values():
        element = _element(described)
        inner_package, slash, inner = element.partition("/")
        if slash and f"{inner_package}/msg/{inner}" not in known:
            _collect(message_class(name, f"{inner_package}/msg/{inner}"), known, texts)


def _element(described: str) -> str:
    """Return the type of what a field holds, or holds many of."""
    found = _SEQUENCE.fullmatch(described) or _ARRAY.fullmatch(described)
    return found["kind"] if found else described


def _field_type(described: str) -> str:
    """Return the type of a field as .msg files have it."""
    if found := _SEQUENCE.fullmatch(described):
        return f"{_field_type(found['kind'])}[{'<=' + found['most'] if found['most'] else ''}]"
    if found := _ARRAY.fullmatch(described):
        return f"{_field_type(found['kind'])}[{found['count']}]"
    if found := _STRING.fullmatch(described):
        return f"{found['kind']}<={found['most']}"
    return _BASE.get(described, described)
