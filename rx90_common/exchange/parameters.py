"""Parameters of nodes: declared with descriptors, changed while a node runs, and checked where rclpy would fail."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import partial
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterEvent,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import nearest, plain, question, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import DEFAULT_ROBOT, DESCRIPTIONS, RobotFiles
from rx90_common.exchange.endpoints import PREFIX, overridable_topics, ros_time
from rx90_common.exchange.topics import PARAMETERS

OF_ROS = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares and looks after itself."""
Effective = Callable[[int], None]
"""To be called, on the executor's thread, with the simulated time, ns, of the first tick that has a change."""
_Group = tuple[tuple[str, ...], Callable[[Mapping[str, Any]], Any], Callable[[Any, Effective], None]]
_Value = TypeVar("_Value", bool, int, float, str, list[float])
_REMEMBERED = 100  # changes that a recorder gets which comes later
_TYPES = [kind.value for kind in Parameter.Type]
_TYPE_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


def declare(
    node: Node,
    name: str,
    default: _Value,
    description: str,
    *,
    low: float | None = None,
    high: float | None = None,
    read_only: bool | None = None,
) -> _Value:
    """Declare a parameter with its descriptor, unless it is declared, and return its value.

    Args:
        node: its owner.
        name: of the parameter.
        default: its value if none is given.
        description: its meaning, with its unit.
        low: the least accepted value.
        high: the largest one.
        read_only: whether it can never be set; None: it can be set on a managed node, see ParameterChanges.
    """
    if not node.has_parameter(name):
        if read_only is None:
            read_only = not isinstance(node, LifecycleNode)
        descriptor = ParameterDescriptor(description=description, read_only=read_only)
        accepted = "list of numbers" if isinstance(default, list) else type(default).__name__
        if low is not None and high is not None:
            accepted += f" in [{low:g}, {high:g}]"
            if isinstance(default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
            else:
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        given = node._parameter_overrides.get(name)  # rclpy names neither value nor range in a way to show
        if given is not None:
            if given.value is None:
                raise ConfigError(f"parameter {name} is empty; accepted: {accepted}")
            node._parameter_overrides[name] = _with_real_numbers(given, default)
        try:
            node.declare_parameter(name, default, descriptor)
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            shown = quoted(None if given is None else given.value)
            raise ConfigError(f"parameter {name} is {shown}; accepted: {accepted}") from error
    value: Any = node.get_parameter(name).value
    if isinstance(value, array):  # as rclpy has lists that were set
        value = value.tolist()
    return value  # type: ignore[no-any-return]


def declare_options(node: Node, owner: type[Any], prefix: str = "") -> dict[str, Any]:
    """Declare each field of a dataclass that is made by `option`, unless it is declared; return the values by field."""
    return {one.name: declare(node, f"{prefix}{one.name}", **one.metadata) for one in fields(owner) if one.metadata}


def declare_rates(node: Node) -> Rates:
    """Declare the rates, which both nodes must have alike, and return them."""
    usual = Rates()
    about = "rate of plant, velocity and current loops, and of the exchange, Hz"
    base = declare(node, "base_rate", usual.base_hz, about, low=100, high=20000)
    about = "rate of the position loop and of set-points, Hz"
    return Rates(base, declare(node, "position_rate", usual.position_hz, about, low=10, high=20000))


def declare_robot_files(node: Node, *names: str) -> RobotFiles:
    """Declare `robot` and a parameter for each of these keys of FILES; return the files that they name."""
    robot = declare(node, "robot", DEFAULT_ROBOT, "robot: name of a shipped one, or your own robot folder")
    of_robot = RobotFiles.named(robot)
    given: dict[str, str | None] = {}
    for name in names:
        override = node._parameter_overrides.get(name)
        if override is not None and override.value == "":  # the value of a launch argument that was left out
            del node._parameter_overrides[name]
        usual = of_robot.text(name)
        chosen = declare(node, name, usual, f"{DESCRIPTIONS[name]}; the robot's or your own")
        given[name] = None if chosen == usual else chosen
    return RobotFiles.named(robot, **given)


def refuse_unknown_parameters(nodes: Sequence[Node]) -> None:
    """Look for values given to parameters that a node has not declared; to be called when all are declared.

    A managed node that is not configured has not declared all of them.
    """
    for node in nodes:
        for name in node._parameter_overrides:
            if not node.has_parameter(name) and name not in OF_ROS:
                owners = [other.get_name() for other in nodes if other.has_parameter(name)]
                alone = f"-p {owners[0]}:{name}:=... for that node alone" if owners else None
                raise ConfigError(unknown_parameter(node, name, alone))


def unknown_parameter(node: Node, name: str, accepted: str | None = None) -> str:
    """Return the result for an unknown parameter, with accepted names; by default the node's parameters."""
    known: list[str] = []
    if accepted is None and name.startswith(PREFIX):
        accepted = overridable_topics(node)
    elif accepted is None:
        known = sorted(one for one in node._parameters if one not in OF_ROS and PREFIX not in one)
        accepted = ", ".join(known)
    asked = question(nearest(name, known))
    return f"parameter {plain(name)} is unknown to {node.get_name()}{asked}; accepted: {accepted}"


class ParameterChanges:
    """Answers every request to set parameters of a managed node.

    In state unconfigured all may be set. Later those of the groups may, which take effect between two ticks; then the
    topic `~/parameters` publishes the change. Values of one request are set together; if the request is atomic and one
    of them is refused, none is set.

    Args:
        node: its parameters are declared by `declare`.
        unconfigured: whether it is in that state.
    """

    def __init__(self, node: Node, unconfigured: Callable[[], bool]) -> None:
        self._node = node
        self._unconfigured = unconfigured
        self._groups: list[_Group] = []
        self._constants: list[str] = []
        self._robot_files: tuple[str, ...] = ()
        qos = QoSProfile(depth=_REMEMBERED, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(ParameterEvent, f"~/{PARAMETERS}", qos)
        node.add_pre_set_parameters_callback(self._complete)
        node.add_on_set_parameters_callback(self._answer)
        node.add_post_set_parameters_callback(self._apply)

    def allow(
        self, names: Sequence[str], check: Callable[[Mapping[str, Any]], Any], apply: Callable[[Any, Effective], None]
    ) -> None:
        """Let declared parameters be changed from now on, until `forbid_all`; they are checked and applied together.

        Args:
            names: of the parameters.
            check: called with the resulting values of all of them; returns the argument of `apply`, raises Rx90Error.
            apply: applies them, and calls its second argument afterwards.
        """
        self._groups.append((tuple(names), check, apply))

    def publish_constants(self, *names: str) -> None:
        """Have `publish_values` publish parameters that cannot be changed, too, until `forbid_all`."""
        self._constants += names

    def forbid_all(self) -> None:
        """Let none be changed, and none of them be published, any more."""
        self._groups.clear()
        self._constants.clear()

    def follow_robot(self, *files: str) -> None:
        """Have these files set with `robot`: those that are the robot's become those of the other robot."""
        self._robot_files = files

    def publish_values(self) -> None:
        """Publish the values that may be changed, and the constants: so a bag has them from its begin on."""
        names = [*(name for group in self._groups for name in group[0]), *self._constants]
        values = [self._node.get_parameter(name).to_parameter_msg() for name in names]
        self._publisher.publish(ParameterEvent(node=self._node.get_fully_qualified_name(), new_parameters=values))

    def _files_of(self, robot: str) -> dict[str, str]:
        """Return the files that come with another robot; raises ConfigError for one that is not there."""
        before = RobotFiles.named(self._node.get_parameter("robot").value)
        now = RobotFiles.named(robot)
        kept = (name for name in self._robot_files if self._node.get_parameter(name).value == before.text(name))
        return {name: now.text(name) for name in kept}

    def _complete(self, given: Sequence[Parameter]) -> list[Parameter]:
        """Return a request with whole numbers made real ones where that is needed, and with a robot's files."""
        known = self._node._parameters
        complete = [_with_real_numbers(each, known[each.name].value) if each.name in known else each for each in given]
        names = {parameter.name for parameter in given}
        for parameter in given:
            if parameter.name == "robot" and self._robot_files and self._unconfigured():
                with suppress(Rx90Error):  # `_answer` reports it
                    files = self._files_of(parameter.value)
                    complete += [Parameter(name, value=file) for name, file in files.items() if name not in names]
        return complete

    def _answer(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for name in (parameter.name for parameter in parameters):
                free = name in OF_ROS or name.startswith(PREFIX) or any(name in group[0] for group in self._groups)
                # A parameter that is not there yet is being declared.
                if not (free or self._unconfigured()) and self._node.has_parameter(name):
                    raise ConfigError(
                        f"{plain(name)} is read when the node is configured; accepted: in state unconfigured, which "
                        f"`ros2 lifecycle set {self._node.get_fully_qualified_name()}` deactivate and cleanup lead to"
                    )
            for parameter in parameters:
                if parameter.name == "robot" and self._robot_files:
                    self._files_of(parameter.value)
            for (_, check, _), values in self._changed(parameters):
                check(values)
        except Rx90Error as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _changed(self, parameters: Sequence[Parameter]) -> list[tuple[_Group, dict[str, Any]]]:
        """Return the groups that a request concerns, with all their values as they would be."""
        given = {parameter.name: parameter.value for parameter in parameters}
        changed = [group for group in self._groups if not given.keys().isdisjoint(group[0])]
        return [(group, {n: given.get(n, self._node.get_parameter(n).value) for n in group[0]}) for group in changed]

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        for (names, check, apply), values in self._changed(parameters):
            event = ParameterEvent(node=self._node.get_fully_qualified_name())
            event.changed_parameters = [each.to_parameter_msg() for each in parameters if each.name in names]
            apply(check(values), partial(self._publish_change, event))

    def _publish_change(self, event: ParameterEvent, stamp_ns: int) -> None:
        event.stamp = ros_time(stamp_ns)
        self._publisher.publish(event)


def _with_real_numbers(given: Parameter, usual: object) -> Parameter:
    """Return the parameter with integers converted to real numbers if these are required: 1 is as good as 1.0."""
    if isinstance(usual, float) and given.type_ is Parameter.Type.INTEGER:
        return Parameter(given.name, Parameter.Type.DOUBLE, float(given.value))
    if not isinstance(usual, bool | int | float | str | bytes) and given.type_ is Parameter.Type.INTEGER_ARRAY:
        return Parameter(given.name, Parameter.Type.DOUBLE_ARRAY, [float(number) for number in given.value])
    return given


def answer_all_requests(node: Node) -> None:
    """Let services refuse what would leave a request without an answer, or forge lines of the log.

    rclpy crashes on a value of a type that does not exist; rcl prints a type hash unchanged, with its line breaks.
    """
    for service in node.services:
        if service.srv_type in (SetParameters, SetParametersAtomically):
            service.callback = partial(_set_parameters, service.callback)
        elif service.srv_type is GetTypeDescription:
            service.callback = partial(_describe_type, service.callback)


def _set_parameters(set_parameters: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    for parameter in request.parameters:
        kind = parameter.value.type
        if kind not in _TYPES:
            reason = f"parameter {quoted(parameter.name)} has a value of type {kind}; accepted: 0 to {max(_TYPES)}"
            result = SetParametersResult(successful=False, reason=reason)
            if isinstance(response, SetParametersAtomically.Response):
                response.result = result
            else:
                response.results = [result] * len(request.parameters)
            return response
    return set_parameters(request, response)


def _describe_type(describe: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    if _TYPE_HASH.fullmatch(request.type_hash):
        return describe(request, response)
    response.failure_reason = f"type_hash is {quoted(request.type_hash)}; accepted: RIHS01_ and 64 digits"
    return response
