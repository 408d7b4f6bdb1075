"""Parameters of the node: files; goals, named as in joint_trajectory_controller; the law, named as in its file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from rx90_common.base.declared import option
from rx90_common.base.errors import ConfigError, located
from rx90_common.base.models import FileModel, unit_of
from rx90_common.base.quoting import quoted
from rx90_common.exchange.lifecycle import ManagedNode
from rx90_common.exchange.parameters import Effective, declare, declare_options
from rx90_common.exchange.topics import DETAIL_DECIMATION, DETAILS
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.model import ModelFiles
from rx90_controller.law.parameters import (
    CS7BParameters,
    FeedForward,
    Servo,
    Supervision,
    load_controller,
    with_model,
)
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.trajectory.request import GoalOptions, GoalTolerances, constraint_parameters
from rx90_controller.trajectory.stream import StreamOptions

FILE_PARAMETERS: Final = ("urdf", "drives", "controller")
"""Files of the robot that the node can be given."""
_LARGEST = 1e6  # rad, rad/s, s
_UNUSED_PARAMETERS = re.compile(
    r"(command_joints|update_rate|is_async|speed_scaling\.(command|state)_interface|open_loop_control|cmd_timeout"
    r"|interpolate_from_desired_state|interpolation_method|allow_integration_in_goal_trajectories"
    r"|set_last_command_interface_value_as_state_on_activation|gains\..+"
    r"|constraints\.(decelerate_on_cancel|[^.]+\.max_deceleration_on_cancel))"
)
_SIMULATED_RATE: Final = "in simulated time, Hz; every whole number of position ticks"
_OF_JOINTS: Final = "; one value for each motor, seen from its joint"


def declare_own(node: Node) -> tuple[float, int]:
    """Declare, unless they are, how far ahead a trajectory may start, s, and the decimation of DETAILS; return both."""
    about = "how far ahead of the controller's own time the stamp of a trajectory may lie, s"
    horizon = declare(node, "max_seconds_ahead", 60.0, about, low=0.0, high=1e6)
    about = f"position ticks for each message of {', '.join(f'~/{name}' for name in DETAILS)}"
    return horizon, declare(node, "slow_topics_every_n_ticks", DETAIL_DECIMATION, about, low=1, high=1_000_000)


@dataclass(frozen=True)
class GoalParameters:
    """Tolerances and options of trajectories and goals, and rates of their feedback.

    Attributes:
        options: permitted exceptions from the checks.
        tolerances: of trajectories, and of goals without tolerances of their own.
        streaming: how streamed set-points are joined.
        unused: parameters of joint_trajectory_controller that were given and have no counterpart here.
        scaling: `speed_scaling.initial_scaling_factor`.
    """

    options: GoalOptions
    tolerances: GoalTolerances
    streaming: StreamOptions
    unused: tuple[str, ...]
    scaling: float
    action_monitor_rate: float = option(20.0, f"rate of the action's feedback, {_SIMULATED_RATE}", 0.1, 20000.0)
    state_publish_rate: float = option(50.0, f"rate of ~/controller_state, {_SIMULATED_RATE}", 0.1, 20000.0)
    controller_manager: str = option(
        "controller_manager",
        "name of the controller_manager whose services this node answers; empty: none, where another one runs",
    )


COMMAND_INTERFACES: Final = ("position",)
STATE_INTERFACES: Final = ("position", "velocity")
"""What the controller takes and measures of each joint, in the words of ros2_control."""
_OF_THE_ARM: Final = {
    "joints": "names of the joints, the arm's",
    "command_interfaces": "what the controller takes for each joint; cannot be chosen",
    "state_interfaces": "what the controller measures of each joint; cannot be chosen",
}


def is_unused(name: str) -> bool:
    """Return whether a parameter of joint_trajectory_controller is accepted for its files' sake, and unused."""
    return name in _OF_THE_ARM or _UNUSED_PARAMETERS.fullmatch(name) is not None


def _take_out(node: Node, names: Sequence[str]) -> tuple[str, ...]:
    """Remove unused parameters from those given to a node, and return them; refuse values that need another arm."""
    given = node._parameter_overrides
    found = {name: given.pop(name).value for name in sorted(given) if is_unused(name)}
    for name, own in zip(_OF_THE_ARM, (names, COMMAND_INTERFACES, STATE_INTERFACES), strict=True):
        value = found.pop(name, own)
        if not (isinstance(value, Sequence) and sorted(map(str, value)) == sorted(own)):
            raise ConfigError(
                f"parameter {name} is {quoted(value)}, {_difference(value, own)}; accepted: {', '.join(own)}, in any "
                "order"
            )
    return tuple(found)


def declare_joints(node: Node, names: Sequence[str]) -> None:
    """Declare joints and interfaces, which are the arm's and read-only, until `forget_robot`."""
    for name, own in zip(_OF_THE_ARM, (names, COMMAND_INTERFACES, STATE_INTERFACES), strict=True):
        node.declare_parameter(name, list(own), ParameterDescriptor(description=_OF_THE_ARM[name]))


def _difference(value: Any, own: Sequence[str]) -> str:
    """Return the superfluous and the missing names of a list, in words."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        return "no list"
    names = [str(each) for each in value]
    more = [name for k, name in enumerate(names) if name not in own or name in names[:k]]
    parts = [f"{what} {', '.join(which)}" for what, which in (
        ("too much:", more), ("missing:", [name for name in own if name not in names])
    ) if which]  # fmt: skip
    return "; ".join(parts)


def declare_goal_parameters(node: Node, names: Sequence[str]) -> GoalParameters:
    """Declare the parameters and return them; `names` are those of the joints.

    Files for joint_trajectory_controller are accepted, too: parameters without a counterpart here are removed.
    """
    tolerances = {
        name: declare(node, name, default, about, low=0.0, high=_LARGEST)
        for name, (default, about) in constraint_parameters(names).items()
    }
    options = GoalOptions(**declare_options(node, GoalOptions))
    own = declare_options(node, GoalParameters)
    about = "share of their own speed at which trajectories are followed, until ~/speed_scaling_input says otherwise"
    scaling = declare(node, "speed_scaling.initial_scaling_factor", 1.0, about, low=0.0, high=1.0)
    streaming = StreamOptions(**declare_options(node, StreamOptions, "stream."))
    held_to = GoalTolerances.of_parameters(names, tolerances)
    return GoalParameters(options, held_to, streaming, _take_out(node, names), scaling, **own)


def allow_goal_changes(node: ManagedNode, cs7b: CS7B, loop: ServoLoop) -> None:
    """Let options and tolerances be changed for the next goals and trajectories."""

    def setter(attribute: str) -> Callable[[Any, Effective], None]:
        def apply(value: Any, effective: Effective) -> None:
            with loop.between_ticks:
                setattr(loop, attribute, value)
                tick = cs7b.position_tick
            effective(tick * cs7b.rates.ratio * cs7b.rates.period_ns)

        return apply

    names = cs7b.joint_names
    options = tuple(option.name for option in fields(GoalOptions))
    node.changes.allow(options, lambda values: GoalOptions(**values), setter("options"))
    tolerances = partial(GoalTolerances.of_parameters, names)
    node.changes.allow(tuple(constraint_parameters(names)), tolerances, setter("tolerances"))


LAW_ENTRIES: Final = tuple(
    f"{section}.{key}"
    for section, block in (("servo", Servo), ("feed_forward", FeedForward), ("supervision", Supervision))
    for key in block.model_fields
    if key not in FileModel.about_keys
)
"""Keys of a controller file whose values may change while the loops run, as `section.key`, with their ranges."""


def forget_robot(node: Node) -> None:
    """Undeclare the law's parameters and the arm's, if they are declared: another robot has others."""
    for name in (*LAW_ENTRIES, *_OF_THE_ARM):
        if node.has_parameter(name):
            node.undeclare_parameter(name)


def declare_law(node: Node, path: Path) -> tuple[CS7BParameters, Callable[[Mapping[str, Any]], CS7BParameters]]:
    """Declare a controller file's values as parameters of a node, checked as the file is.

    Returns:
        The file's parameters, overridden by those given at the start, and a function that returns them
        with other values of LAW_ENTRIES and raises ConfigError.
    """
    law = load_controller(path)

    def read(values: Mapping[str, Any]) -> CS7BParameters:
        changes: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            block, _, key = name.partition(".")
            changes.setdefault(block, {})[key] = value if isinstance(value, bool | float) else list(value)
        with located("parameter"):
            changed = law.replaced(**changes)
        return with_model(changed, changed.model or ModelFiles(), "parameter")

    given: dict[str, Any] = {}
    for name in LAW_ENTRIES:
        block, _, key = name.partition(".")
        holder = getattr(law, block)
        value = getattr(holder, key)
        unit = unit_of(type(holder), key)
        about = str(type(holder).model_fields[key].description)[:-1]
        if len(unit) > 1:
            about += f", {unit}"
        if isinstance(value, tuple):
            value = list(value)
            about += _OF_JOINTS
        given[name] = declare(node, name, value, about)
    return read(given), read
