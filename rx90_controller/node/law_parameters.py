"""Gains, feed-forward and supervision of the controller file as parameters, which may change in a motion."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node

from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Entry, Numbers
from rx90_common.base.groups import Group
from rx90_common.base.section import Section
from rx90_common.exchange.lifecycle import ManagedNode
from rx90_common.exchange.node_tools import declare
from rx90_common.exchange.parameter_changes import ChangeGroup, Effective
from rx90_controller.law.parameters import CONTROLLER, CS7BParameters, read_controller

_OF_JOINTS: Final = "; six values, one for each motor, seen from its joint"
_CHANGEABLE: Final = ("servo", "feed_forward", "supervision")


def _about(shape: Entry) -> str:
    """Return what a value of the controller file means, as other parameters say it."""
    unit = f", {shape.unit}" if len(shape.unit) > 1 else ""
    return f"{shape.about[:-1]}{unit}{_OF_JOINTS if isinstance(shape, Numbers) else ''}"


LAW_ENTRIES: Final = {
    f"{section}.{key}": shape
    for section, group in CONTROLLER.keys.items()
    if section in _CHANGEABLE and isinstance(group, Group)
    for key, shape in group.keys.items()
}
"""The keys of a controller file whose values may change while the loops run, as `section.key`; what they may be."""


def forget_law_parameters(node: Node) -> None:
    """Undeclare the parameters, if they are declared: another file has other values."""
    for name in LAW_ENTRIES:
        if node.has_parameter(name):
            node.undeclare_parameter(name)


class LawParameters:
    """A controller file's values as parameters of the node: declared with the file's values, checked as the file is.

    Args:
        node: their owner.
        path: the controller file.
        record: returns the law's constants, shape (1,), CONTROLLER_DTYPE.

    Attributes:
        parameters: of the file, with what was given at the start in place of the file's.

    Raises:
        ConfigError: naming file or parameter, value and accepted range.
    """

    def __init__(self, node: ManagedNode, path: Path, record: Callable[[CS7BParameters], Any]) -> None:
        self._node, self._record = node, record
        root = load_yaml(path)
        self._model = read_controller(root).model  # whose files are read once
        self._content = CONTROLLER.read(root)
        given = {name: declare(node, name, self._of_file(name), _about(shape)) for name, shape in LAW_ENTRIES.items()}
        self.parameters = self._read(given)

    def change_with(self, change: Callable[[Any, Effective], None]) -> None:
        """Let the parameters be set: `change` gets the constants, and what to call with the time of their effect."""
        group = ChangeGroup(tuple(LAW_ENTRIES), lambda values: self._record(self._read(values)), change)
        self._node.changes.allow(group)

    def _of_file(self, name: str) -> Any:
        section, _, key = name.partition(".")
        value = self._content[section][key]
        if isinstance(value, bool):
            return value
        return [float(each) for each in value] if isinstance(value, tuple) else float(value)

    def _read(self, values: Mapping[str, Any]) -> CS7BParameters:
        content = copy.deepcopy(self._content)
        for name, value in values.items():
            section, _, key = name.partition(".")
            content[section][key] = value if isinstance(value, bool | float) else list(value)
        return read_controller(Section(content, Path("parameter")), self._model)
