"""What others ask of a managed node: its state, transitions, parameters; and what it prints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.parameter import Parameter

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import ClientNode
from rx90_common.exchange.service_calls import ServiceCalls, ServiceRequest

_EVENTS = 10
_LINES = 100


def state_request(node: str) -> ServiceRequest:
    """Return the question for the state of a managed node; the answer is its label."""
    return ServiceRequest(
        GetState, f"{node}/get_state", GetState.Request(), lambda answer: str(answer.current_state.label)
    )


def transition_request(node: str, label: str) -> ServiceRequest:
    """Return the request for a transition of a managed node, by its label."""
    service = f"{node}/change_state"

    def read(answer: Any) -> str:
        if not answer.success:
            raise ExchangeError(f"{service}: {label} was refused; the node's log says why")
        return f"{label}: done"

    return ServiceRequest(ChangeState, service, ChangeState.Request(transition=Transition(label=label)), read)


def parameter_request(node: str, name: str, value: Any) -> ServiceRequest:
    """Return the request to set a parameter of a node."""
    service = f"{node}/set_parameters"

    def read(answer: Any) -> str:
        refused = [result.reason for result in answer.results if not result.successful]
        if refused:
            raise ExchangeError(f"{service}: {refused[0]}")
        return f"{name}: set"

    given = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return ServiceRequest(SetParameters, service, given, read)


def text_parameter(client: ClientNode, node: str, name: str) -> str:
    """Return a parameter of a node that is a text; empty where there is no such node, or parameter.

    Raises:
        ExchangeError: if the node does not answer within the client's timeout.
    """
    service = client.node.resolve_service_name(f"{node}/get_parameters")
    if service not in dict(client.node.get_service_names_and_types()):
        return ""
    (found,) = client.call(GetParameters, service, GetParameters.Request(names=[name])).values
    return str(found.string_value)


class NodeWatch:
    """Follows the state of a managed node.

    Args:
        client: the node to do it with.
        calls: of services.
        node: name of the managed node.

    Attributes:
        state: its label; empty while the node is not there, or has not answered.
    """

    def __init__(self, client: ClientNode, calls: ServiceCalls, node: str) -> None:
        self._calls, self._asked = calls, state_request(node)
        self.state = ""
        self._asking = False
        client.node.create_subscription(TransitionEvent, f"{node}/transition_event", self._take, _EVENTS)

    def look(self) -> None:
        """Ask a node that has come for its state, and see whether it has gone; to be called now and then."""
        if not self._calls.there(self._asked):
            self.state = ""
        elif not self.state and not self._asking:
            self._asking = True
            self._calls.ask(self._asked, self._answered)

    def _answered(self, outcome: str | ExchangeError) -> None:
        self._asking = False
        if not isinstance(outcome, ExchangeError):
            self.state = outcome

    def _take(self, event: TransitionEvent) -> None:
        self.state = str(event.goal_state.label)


def hear_log(client: ClientNode, nodes: Sequence[str], heard: Callable[[str, str, bool], None]) -> None:
    """Call `heard` with each line that one of some nodes logs from now on.

    Args:
        client: the node to hear with.
        nodes: their names, relative to its namespace or absolute.
        heard: takes the name as it is in `nodes`, the line, and whether that is a warning or an error; within
            `ClientNode.spin`.
    """
    # A log bears the absolute name without the first slash, and with dots for the others.
    names = {client.node.resolve_topic_name(name).strip("/").replace("/", "."): name for name in nodes}

    def take(line: Log) -> None:
        if line.name in names:
            heard(names[line.name], str(line.msg), line.level >= LoggingSeverity.WARN)

    client.node.create_subscription(Log, "/rosout", take, _LINES)
