"""Parameters changed while a node runs: which may be, why not elsewhere, and from which simulated time on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

from rcl_interfaces.msg import ParameterEvent, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import plain
from rx90_common.exchange.message_times import ros_time
from rx90_common.exchange.topics import PARAMETERS

OF_ROS = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares and looks after itself."""
_OF_QOS = "qos_overrides."  # likewise
_REMEMBERED = 100  # changes that a recorder is told of which comes later
Effective = Callable[[int], None]
"""To be called, on the executor's thread, with the simulated time, ns, of the first tick that has a change."""


class ChangeGroup(NamedTuple):
    """Parameters that are checked and applied together.

    Attributes:
        names: of declared parameters.
        check: gets the values of all of them as they would be; returns what `apply` needs, raises Rx90Error.
        apply: makes them count, and sees to it that its second argument is called.
    """

    names: tuple[str, ...]
    check: Callable[[Mapping[str, Any]], Any]
    apply: Callable[[Any, Effective], None]


class ParameterChanges:
    """Answers every request to set parameters of a managed node.

    In state unconfigured all may be set. Later those of the groups may, which take effect between two ticks; then the
    topic `~/parameters` says so. Values of one request are set together or, where the request is atomic and one of them
    is refused, not at all.

    Args:
        node: its parameters are declared by `node_tools.declare`.
        unconfigured: whether it is in that state.
    """

    def __init__(self, node: Node, unconfigured: Callable[[], bool]) -> None:
        self._node, self._unconfigured = node, unconfigured
        self._groups: list[ChangeGroup] = []
        self._told: list[str] = []
        self._leading: dict[str, Callable[[Any], Mapping[str, Any]]] = {}
        qos = QoSProfile(depth=_REMEMBERED, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(ParameterEvent, f"~/{PARAMETERS}", qos)
        node.add_pre_set_parameters_callback(self._complete)
        node.add_on_set_parameters_callback(self._answer)
        node.add_post_set_parameters_callback(self._apply)

    def allow(self, group: ChangeGroup) -> None:
        """Let a group be changed from now on, until `forbid_all`."""
        self._groups.append(group)

    def tell(self, name: str) -> None:
        """Let `tell_values` tell a parameter that cannot be changed, too, until `forbid_all`."""
        self._told.append(name)

    def forbid_all(self) -> None:
        """Let none be changed, and none of them be told, any more."""
        self._groups.clear()
        self._told.clear()

    def lead(self, name: str, others: Callable[[Any], Mapping[str, Any]]) -> None:
        """Have other parameters set with one: `others` returns their values for one of `name`, or raises Rx90Error."""
        self._leading[name] = others

    def tell_values(self) -> None:
        """Publish the values that may be changed or are to be told: so a bag has them from its begin on."""
        names = [*(name for group in self._groups for name in group.names), *self._told]
        values = [self._node.get_parameter(name).to_parameter_msg() for name in names]
        self._publisher.publish(ParameterEvent(node=self._node.get_fully_qualified_name(), new_parameters=values))

    def _complete(self, given: Sequence[Parameter]) -> list[Parameter]:
        """Return a request with whole numbers made real ones where that is needed, and with what it leads to."""
        known = self._node._parameters
        all_of_it = [with_real_numbers(each, known[each.name].value) if each.name in known else each for each in given]
        names = {parameter.name for parameter in given}
        for parameter in given:
            if parameter.name in self._leading and self._unconfigured():
                with suppress(Rx90Error):  # `_answer` says so
                    others = self._leading[parameter.name](parameter.value)
                    all_of_it += [Parameter(name, value=value) for name, value in others.items() if name not in names]
        return all_of_it

    def _answer(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                self._check_state(parameter.name)
                if parameter.name in self._leading:
                    self._leading[parameter.name](parameter.value)
            for group, values in self._changed(parameters):
                group.check(values)
        except Rx90Error as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_state(self, name: str) -> None:
        free = name in OF_ROS or name.startswith(_OF_QOS) or any(name in group.names for group in self._groups)
        # A parameter that is not there yet is being declared.
        if free or self._unconfigured() or not self._node.has_parameter(name):
            return
        node = self._node.get_fully_qualified_name()
        raise ConfigError(
            f"{plain(name)} is read when the node is configured; accepted: in state unconfigured, which `ros2 "
            f"lifecycle set {node}` deactivate and cleanup lead to"
        )

    def _changed(self, parameters: Sequence[Parameter]) -> list[tuple[ChangeGroup, dict[str, Any]]]:
        """Return the groups that a request concerns, with all their values as they would be."""
        given = {parameter.name: parameter.value for parameter in parameters}
        changed = [group for group in self._groups if not given.keys().isdisjoint(group.names)]
        return [(group, {n: given.get(n, self._node.get_parameter(n).value) for n in group.names}) for group in changed]

    def _apply(self, parameters: Sequence[Parameter]) -> None:
        for group, values in self._changed(parameters):
            changed = [parameter for parameter in parameters if parameter.name in group.names]
            group.apply(group.check(values), partial(self._tell, changed))

    def _tell(self, changed: Sequence[Parameter], stamp_ns: int) -> None:
        event = ParameterEvent(stamp=ros_time(stamp_ns), node=self._node.get_fully_qualified_name())
        event.changed_parameters = [parameter.to_parameter_msg() for parameter in changed]
        self._publisher.publish(event)


def with_real_numbers(given: Parameter, usual: object) -> Parameter:
    """Return the parameter with whole numbers made real ones where those are asked for: 1 is as good as 1.0."""
    if isinstance(usual, float) and given.type_ is Parameter.Type.INTEGER:
        return Parameter(given.name, Parameter.Type.DOUBLE, float(given.value))
    if not isinstance(usual, bool | int | float | str | bytes) and given.type_ is Parameter.Type.INTEGER_ARRAY:
        return Parameter(given.name, Parameter.Type.DOUBLE_ARRAY, [float(number) for number in given.value])
    return given
