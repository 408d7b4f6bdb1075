"""Gains, feed-forward and supervision of the controller file as parameters, which may change in a motion."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node

from rx90_common.base.config import load_yaml
from rx90_common.base.section import Section
from rx90_common.exchange.lifecycle import ManagedNode
from rx90_common.exchange.node_tools import declare
from rx90_common.exchange.parameter_changes import ChangeGroup, Effective
from rx90_controller.law.parameters import CS7BParameters, read_controller

_OF_JOINTS: Final = "; six values, one for each motor, seen from its joint"
_ABOUT: Final = {
    "servo.inertia": f"nominal inertia, kg m^2{_OF_JOINTS}",
    "servo.kp": f"proportional gain of the position loop, 1/s{_OF_JOINTS}",
    "servo.kv": f"gain of the velocity loop, 1/s{_OF_JOINTS}",
    "servo.ki": f"integral gain, 1/s^3{_OF_JOINTS}",
    "servo.integrator_limit": f"the most the integrator gives, Nm{_OF_JOINTS}",
    "feed_forward.velocity": "the velocity set-point in the D block",
    "feed_forward.acceleration": "inertia times acceleration set-point",
    "feed_forward.coulomb": "Coulomb friction compensation",
    "feed_forward.viscous": "viscous friction compensation",
    "feed_forward.coulomb_torque": f"Coulomb friction to compensate, Nm{_OF_JOINTS}",
    "feed_forward.coulomb_velocity": "velocity set-point at which the Coulomb compensation is complete, rad/s",
    "feed_forward.viscous_friction": f"viscous friction to compensate, Nm (s/rad)^viscous_exponent{_OF_JOINTS}",
    "feed_forward.viscous_exponent": f"exponent of the viscous friction to compensate{_OF_JOINTS}",
    "supervision.following_error": f"position error at which the power is cut, rad{_OF_JOINTS}",
    "supervision.over_speed": "speed at which the power is cut, times the nominal speed of the joint",
}
"""The keys of a controller file whose values may change while the loops run, as `section.key`; what they mean."""
_USUAL: Final = {"feed_forward.viscous_exponent": [1.0] * 6}
"""Where the file leaves a key out."""


def forget_law_parameters(node: Node) -> None:
    """Undeclare the parameters, if they are declared: another file has other values."""
    for name in _ABOUT:
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
        read_controller(root)
        self._content = root.content
        given = {name: declare(node, name, self._of_file(name), about) for name, about in _ABOUT.items()}
        self.parameters = self._read(given)

    def change_with(self, change: Callable[[Any, Effective], None]) -> None:
        """Let the parameters be set: `change` gets the constants, and what to call with the time of their effect."""
        group = ChangeGroup(tuple(_ABOUT), lambda values: self._record(self._read(values)), change)
        self._node.changes.allow(group)

    def _of_file(self, name: str) -> Any:
        section, _, key = name.partition(".")
        value = self._content[section].get(key, _USUAL.get(name))
        if isinstance(value, bool):
            return value
        return [float(each) for each in value] if isinstance(value, list) else float(value)

    def _read(self, values: Mapping[str, Any]) -> CS7BParameters:
        content = copy.deepcopy(self._content)
        for name, value in values.items():
            section, _, key = name.partition(".")
            content[section][key] = value if isinstance(value, bool | float) else list(value)
        return read_controller(Section(content, Path("parameter")))
