"""Parameters of the node: files; goals, named as in joint_trajectory_controller; the law, named as in its file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Annotated, Any, TypeAlias

from pydantic import Field

from rx90_common.base.errors import ConfigError
from rx90_common.base.models import Model, quantity
from rx90_common.base.quoting import nearest, plain, question, quoted
from rx90_common.description.robot import load_robot
from rx90_common.exchange.parameters import RobotParameters, nested, robots_file
from rx90_common.exchange.topics import DETAIL_DECIMATION, DETAILS
from rx90_controller.law.parameters import (
    CS7BParameters,
    FeedForward,
    Servo,
    Supervision,
    load_controller,
)
from rx90_controller.trajectory.request import Constraints, GoalOptions, GoalTolerances
from rx90_controller.trajectory.stream import StreamOptions

_UNUSED_PARAMETERS = re.compile(
    r"(command_joints|update_rate|is_async|speed_scaling\.(command|state)_interface|open_loop_control|cmd_timeout"
    r"|interpolate_from_desired_state|interpolation_method|allow_integration_in_goal_trajectories"
    r"|set_last_command_interface_value_as_state_on_activation|gains\..+"
    r"|constraints\.(decelerate_on_cancel|[^.]+\.max_deceleration_on_cancel))"
)
COMMAND_INTERFACES = ("position",)
STATE_INTERFACES = ("position", "velocity")
"""What the controller takes and measures of each joint, in the words of ros2_control."""
LAW_BLOCKS = ("servo", "feed_forward", "supervision")
"""Mappings of a controller file whose values may change while the loops run."""
OF_ROBOT = (*LAW_BLOCKS, "joints", "command_interfaces", "state_interfaces")
"""Parameters of the arm and its law, which another robot has otherwise."""
_rate = partial(quantity, "Hz", ge=0.1, le=20000.0)


class ControllerFiles(RobotParameters):
    """The parameters of a node that has no robot yet."""

    controller: Annotated[str, robots_file("controller")] = ""
    max_seconds_ahead: Annotated[
        float,
        quantity(
            "s",
            "How far ahead of the controller's own time the stamp of a trajectory may lie.",
            ge=0.0,
            le=1e6,
        ),
    ] = 60.0
    slow_topics_every_n_ticks: Annotated[
        int,
        Field(
            ge=1,
            le=1_000_000,
            description=f"Position ticks for each message of {', '.join(f'~/{name}' for name in DETAILS)}.",
        ),
    ] = DETAIL_DECIMATION


class SpeedScaling(Model):
    """The speed at which trajectories are followed."""

    initial_scaling_factor: Annotated[
        float,
        quantity(
            "1",
            "Share of their own speed at which trajectories are followed, until ~/speed_scaling_input says otherwise.",
            ge=0.0,
            le=1.0,
        ),
    ] = 1.0


_Names: TypeAlias = Annotated[tuple[str, ...], Field(strict=False)]


class ControllerParameters(ControllerFiles, GoalOptions):
    """The node's parameters: those of joint_trajectory_controller by its names, and the law's as in its file."""

    joints: Annotated[_Names, Field(description="Names of the joints, the arm's.")] = ()
    command_interfaces: Annotated[
        _Names, Field(description="What the controller takes for each joint; cannot be chosen.")
    ] = COMMAND_INTERFACES
    state_interfaces: Annotated[
        _Names, Field(description="What the controller measures of each joint; cannot be chosen.")
    ] = STATE_INTERFACES
    constraints: Constraints = Constraints()
    action_monitor_rate: Annotated[
        float,
        _rate(
            "Rate of the action's feedback, in simulated time; every whole number of position ticks."
        ),
    ] = 20.0
    state_publish_rate: Annotated[
        float,
        _rate(
            "Rate of ~/controller_state, in simulated time; every whole number of position ticks."
        ),
    ] = 50.0
    controller_manager: Annotated[
        str,
        Field(
            description="Name of the controller_manager whose services this node answers; empty: none, where another "
            "one runs."
        ),
    ] = "controller_manager"
    speed_scaling: SpeedScaling = SpeedScaling()
    stream: StreamOptions = StreamOptions()
    servo: Servo
    feed_forward: FeedForward
    supervision: Supervision

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is given, and for the rest what the files say.

        Raises:
            ConfigError: for files that are none, and for joints and interfaces that are not the arm's.
        """
        content = nested(
            {name: value for name, value in given.items() if not _UNUSED_PARAMETERS.fullmatch(name)}
        )
        files = ControllerFiles.of(content).files()
        names = load_robot(files.urdf).joint_names
        law = load_controller(files.controller)
        for block in LAW_BLOCKS:
            content[block] = _merged(dict(getattr(law, block)), content.get(block, {}))
        constraints = content["constraints"] = _merged(
            {name: {} for name in names}, content.get("constraints", {})
        )
        if isinstance(constraints, dict):
            accepted = (*Constraints.model_fields, *names)
            for name in constraints:
                if name not in accepted:
                    near = question(nearest(name, accepted))
                    raise ConfigError(
                        f"parameter constraints.{plain(name)} is unknown{near}; accepted: {', '.join(accepted)}"
                    )
        of_arm = {
            "joints": names,
            "command_interfaces": COMMAND_INTERFACES,
            "state_interfaces": STATE_INTERFACES,
        }
        for place, values in of_arm.items():
            value = content.setdefault(place, values)
            if not isinstance(value, list | tuple) or sorted(map(str, value)) != sorted(values):
                words = f"{', '.join(values)}, in any order"
                raise ConfigError(f"parameter {place} is {quoted(value)}; accepted: {words}")
            content[place] = values
        return content

    def check_files(self) -> None:
        """Check the law by the file of the controller."""
        self.law(load_controller(self.files().controller))

    def law(self, of_file: CS7BParameters) -> CS7BParameters:
        """Return the law, with what the file of the controller says beside LAW_BLOCKS."""
        return law_of(of_file, {block: dict(getattr(self, block)) for block in LAW_BLOCKS})

    @property
    def tolerances(self) -> GoalTolerances:
        """Return the tolerances of trajectories, and of goals without tolerances of their own."""
        return GoalTolerances.of_parameters(self.joints, self.constraints)


def unused_parameters(given: Iterable[str]) -> list[str]:
    """Return the names that joint_trajectory_controller alone has: accepted for its files' sake, and unused."""
    return sorted(name for name in given if _UNUSED_PARAMETERS.fullmatch(name))


def _merged(values: dict[str, Any], given: Any) -> Any:
    return {**values, **given} if isinstance(given, dict) else given


def law_of(law: CS7BParameters, values: Mapping[str, Any]) -> CS7BParameters:
    """Return a law with other values of LAW_BLOCKS; the files of its model are read where it needs them.

    Args:
        law: of the file.
        values: by block, or by full name.

    Raises:
        ConfigError: naming the parameter, its value and what is accepted.
    """
    try:
        changed = law.replaced(**nested(values))
        if changed.model is not None and changed.feed_forward.model_parts:
            _ = changed.model.constants
    except ConfigError as error:
        raise ConfigError(f"parameter {error}") from None
    return changed
