"""Parameters of nodes: declared with descriptors, and changed while a node runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field, ValidationError, model_validator
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterEvent,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.models import (
    FileModel,
    JsonSchema,
    Model,
    as_refusal,
    fault_lines,
    quantity,
    schema_of,
)
from rx90_common.base.quoting import nearest, plain, question
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import (
    DEFAULT_ROBOT,
    DESCRIPTIONS,
    FILES,
    RobotFiles,
    robot_folder,
)
from rx90_common.exchange.endpoints import ros_time
from rx90_common.exchange.topics import PARAMETERS

OF_ROS = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares and looks after itself."""
Effective = Callable[[int], None]
"""To be called, on the executor's thread, with the simulated time, ns, of the first tick that has a change."""
_Group = tuple[
    tuple[str, ...], Callable[[Mapping[str, Any]], Any], Callable[[Any, Effective], None]
]
_REMEMBERED = 100  # changes that a recorder gets which comes later
_REAL_FOR_WHOLE = {
    (Parameter.Type.INTEGER, Parameter.Type.DOUBLE),
    (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY),
}
"""Types of values that may be given, and of those that are wanted."""
AnyNodeModel = TypeVar("AnyNodeModel", bound="NodeModel")


class NodeModel(Model):
    """Parameters of a node, as its file has them: a mapping for each dot of a name."""

    @classmethod
    def of(cls: type[AnyNodeModel], given: Mapping[str, Any]) -> AnyNodeModel:
        """Return the parameters of a node for what it was given by name, without names that the model does not know.

        Raises:
            ConfigError: naming the parameter, its value and what is accepted.
        """
        known = {
            name: value for name, value in cls.completed(given).items() if name in cls.model_fields
        }
        try:
            return cls.model_validate(known)
        except ValidationError as error:
            raise ConfigError(f"parameter {fault_lines(cls, error, '', known)[0]}") from None

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the parameters come to, unchecked, a mapping for each dot of a name; may raise ConfigError."""
        return nested(given)

    def check_files(self) -> None:
        """Check the parameters by the files that they name; raises Rx90Error."""


class RateParameters(NodeModel):
    """The rates, which both nodes must have alike."""

    base_rate: Annotated[
        int,
        quantity(
            "Hz",
            "Rate of plant, velocity and current loops, and of the exchange.",
            ge=100,
            le=20000,
        ),
    ] = Rates().base_hz
    position_rate: Annotated[
        int, quantity("Hz", "Rate of the position loop and of set-points.", ge=10, le=20000)
    ] = Rates().position_hz

    @model_validator(mode="after")
    def _check_rates(self) -> RateParameters:
        with as_refusal():
            _ = self.rates
        return self

    @property
    def rates(self) -> Rates:
        """Return the rates."""
        return Rates(self.base_rate, self.position_rate)


def robots_file(role: str) -> Any:
    """Return the Field of a parameter that names a file in place of the robot's."""
    about = DESCRIPTIONS[role]
    return Field(description=f"{about[0].upper()}{about[1:]}; the robot's if empty.")


class RobotParameters(RateParameters):
    """Robot and rates of a node; a file without a name is the robot's."""

    autostart: Annotated[
        bool,
        Field(
            description="Configure and activate the node when it starts; else that is left to its lifecycle services.",
            json_schema_extra={"read_only": True},
        ),
    ] = True
    robot: Annotated[
        str, Field(description="Robot: name of a shipped one, or your own robot folder.")
    ] = DEFAULT_ROBOT
    urdf: Annotated[str, robots_file("urdf")] = ""
    drives: Annotated[str, robots_file("drives")] = ""

    def files(self) -> RobotFiles:
        """Return the robot's files, and those that are named in their place."""
        return RobotFiles.named(
            self.robot, **{role: name for role, name in self if role in FILES and name}
        )


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters by the parts of their names, a mapping for each dot; what is no mapping wins."""
    content: dict[str, Any] = {}
    for name, value in values.items():
        *above, last = name.split(".")
        inner = content
        for key in above:
            inner = inner.setdefault(key, {})
            if not isinstance(inner, dict):
                break
        else:
            inner[last] = value
    return content


def leaves(values: Model, before: str = "") -> Iterator[tuple[str, Any, JsonSchema]]:
    """Yield name, value and JSON schema of each parameter."""
    for key, value in values:
        if key in FileModel.about_keys:
            continue
        if isinstance(value, Model):
            yield from leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value, schema_of(type(values))["properties"][key]


def _descriptor(schema: JsonSchema, value: Any, read_only: bool) -> ParameterDescriptor:
    unit = schema.get("unit", "1")
    descriptor = ParameterDescriptor(
        description=schema["description"] if unit == "1" else f"{schema['description']} [{unit}]",
        read_only=schema.get("read_only", read_only),
    )
    if {"minimum", "maximum"} <= schema.keys():
        low = type(value)(schema["minimum"])
        high = type(value)(schema["maximum"])
        if isinstance(value, int):
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor


@contextmanager
def named_parameters() -> Iterator[None]:
    """Refuse, while a node is made, a parameter that is given without a value, of which rclpy says less."""
    try:
        yield
    except ValueError as error:
        if "PARAMETER_NOT_SET" not in str(error):
            raise
        raise ConfigError(
            "a parameter is given without a value; accepted: -p NAME:=VALUE"
        ) from error


class NodeParameters:
    """The parameters that a node is given, and those that it declares by models.

    Args:
        node: made with `automatically_declare_parameters_from_overrides`; what it was given is taken out.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._given: dict[str, Any] = {}
        for name, value in parameter_values(node).items():
            if name not in OF_ROS:
                self._given[name] = value
                node.undeclare_parameter(name)

    @property
    def values(self) -> dict[str, Any]:
        """Return what the node was given, and what is declared, by name."""
        return {**self._given, **parameter_values(self._node)}

    def declare(self, values: NodeModel) -> None:
        """Declare those parameters of a model that are not declared; a node that is not managed has them read-only."""
        read_only = not isinstance(self._node, LifecycleNode)
        for name, value, schema in leaves(values):
            if not self._node.has_parameter(name):
                plain_value = list(value) if isinstance(value, tuple) else value
                descriptor = _descriptor(schema, value, read_only)
                self._node.declare_parameter(name, plain_value, descriptor, ignore_override=True)

    def forget(self, *names: str) -> None:
        """Undeclare parameters, or those in mappings, by their first names: another robot has others."""
        for name in self._node.get_parameters_by_prefix(""):
            if name.partition(".")[0] in names:
                self._node.undeclare_parameter(name)

    def ignore(self, names: Sequence[str]) -> None:
        """Take what was given under these names for known."""
        for name in names:
            self._given.pop(name, None)

    def refuse_unknown(self) -> None:
        """Look for values given to parameters that the node has not declared; to be called when all are declared.

        A managed node that is not configured has not declared all of them.
        """
        for name in self._given:
            if not self._node.has_parameter(name):
                raise ConfigError(unknown_parameter(self._node, name))


def parameter_values(node: Node) -> dict[str, Any]:
    """Return the values of a node's declared parameters by name."""
    declared: Any = node.get_parameters_by_prefix("")  # rclpy's own annotation has values
    return {
        name: parameter_value_to_python(declared[name].get_parameter_value()) for name in declared
    }


def unknown_parameter(node: Node, name: str) -> str:
    """Return the result for an unknown parameter, with the node's own."""
    known = sorted(one for one in node.get_parameters_by_prefix("") if one not in OF_ROS)
    asked = question(nearest(name, known))
    accepted = ", ".join(known)
    return f"parameter {plain(name)} is unknown to {node.get_name()}{asked}; accepted: {accepted}"


class ParameterChanges:
    """Answers every request to set parameters of a managed node.

    In state unconfigured all may be set. Later those of the groups may, which take effect between two ticks; then the
    topic `~/parameters` publishes the change. Values of one request are set together; if the request is atomic and one
    of them is refused, none is set.

    Args:
        node: its parameters are declared by NodeParameters.
        unconfigured: whether it is in that state.
    """

    def __init__(self, node: Node, unconfigured: Callable[[], bool]) -> None:
        self._node = node
        self._unconfigured = unconfigured
        self._groups: list[_Group] = []
        self._constants: list[str] = []
        qos = QoSProfile(depth=_REMEMBERED, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(ParameterEvent, f"~/{PARAMETERS}", qos)
        node.add_pre_set_parameters_callback(self._complete)
        node.add_on_set_parameters_callback(self._answer)
        node.add_post_set_parameters_callback(self._apply)

    def allow(
        self,
        names: Sequence[str],
        check: Callable[[Mapping[str, Any]], Any],
        apply: Callable[[Any, Effective], None],
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

    def publish_values(self) -> None:
        """Publish the values that may be changed, and the constants: so a bag has them from its begin on."""
        names = [*(name for group in self._groups for name in group[0]), *self._constants]
        values = [self._node.get_parameter(name).to_parameter_msg() for name in names]
        self._publisher.publish(
            ParameterEvent(node=self._node.get_fully_qualified_name(), new_parameters=values)
        )

    def _complete(self, given: Sequence[Parameter]) -> list[Parameter]:
        """Return a request with whole numbers made real ones where that is needed."""
        declared: Any = self._node.get_parameters_by_prefix("")
        return [_with_real_numbers(parameter, declared) for parameter in given]

    def _answer(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for name in (parameter.name for parameter in parameters):
                free = name in OF_ROS or any(name in group[0] for group in self._groups)
                # A parameter that is not there yet is being declared.
                if not (free or self._unconfigured()) and self._node.has_parameter(name):
                    raise ConfigError(
                        f"{plain(name)} is read when the node is configured; accepted: in state unconfigured, which "
                        f"`ros2 lifecycle set {self._node.get_fully_qualified_name()}` deactivate and cleanup lead to"
                    )
            for parameter in parameters:
                if parameter.name == "robot":
                    robot_folder(str(parameter.value))
            for (_, check, _), values in self._changed(parameters):
                check(values)
        except Rx90Error as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _changed(self, parameters: Sequence[Parameter]) -> list[tuple[_Group, dict[str, Any]]]:
        """Return the groups that a request concerns, with all their values as they would be."""
        given = {parameter.name: parameter.value for parameter in parameters}
        changed = [group for group in self._groups if not given.keys().isdisjoint(group[0])]
        return [
            (group, {n: given.get(n, self._node.get_parameter(n).value) for n in group[0]})
            for group in changed
        ]

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        for (names, check, apply), values in self._changed(parameters):
            event = ParameterEvent(node=self._node.get_fully_qualified_name())
            event.changed_parameters = [
                each.to_parameter_msg() for each in parameters if each.name in names
            ]
            apply(check(values), partial(self._publish_change, event))

    def _publish_change(self, event: ParameterEvent, stamp_ns: int) -> None:
        event.stamp = ros_time(stamp_ns)
        self._publisher.publish(event)


def _with_real_numbers(given: Parameter, declared: Mapping[str, Parameter]) -> Parameter:
    """Return the parameter with integers converted to real numbers if these are required: 1 is as good as 1.0."""
    usual = declared.get(given.name, given).type_
    if (given.type_, usual) not in _REAL_FOR_WHOLE:
        return given
    return Parameter(given.name, usual, np.asarray(given.value, np.float64).tolist())
