"""A client of the simulation node's services pause, step and reset that follows its time."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import message_time_ns
from rx90_common.exchange.client_node import ClientNode, ServiceRequest, spoken

_NAME = "rx90_sim"


class SimulationClient:
    """The services of a simulation node; each raises ExchangeError if the request is not carried out.

    Attributes:
        time: newest simulated time, s, updated by `ClientNode.spin`.
    """

    def __init__(self, client: ClientNode) -> None:
        self._client = client
        self.time = 0.0
        client.node.create_subscription(Clock, "/clock", self._on_clock, 10)

    def _on_clock(self, message: Clock) -> None:
        self.time = message_time_ns(message.clock) / NANOSECONDS

    def pause(self, paused: bool) -> None:
        """Stop time, or let it run."""
        self._ask(pause_request(_NAME, paused))

    def step(self) -> None:
        """Pause, and run `step_ticks` ticks, a parameter of the simulation."""
        self._ask(step_request(_NAME))

    def reset(self) -> None:
        """Begin again at tick 0."""
        self._ask(reset_request(_NAME))

    def _ask(self, request: ServiceRequest) -> None:
        request.read(self._client.call(request.kind, request.service, request.request))


def pause_request(node: str, paused: bool) -> ServiceRequest:
    """Return the request to stop the time of a simulation or to let it run."""
    return _request(SetBool, f"{node}/pause", SetBool.Request(data=paused))


def step_request(node: str) -> ServiceRequest:
    """Return the request to a simulation to pause and to run `step_ticks` ticks, its parameter."""
    return _request(Trigger, f"{node}/step", Trigger.Request())


def reset_request(node: str) -> ServiceRequest:
    """Return the request to a simulation to begin again at tick 0."""
    return _request(Trigger, f"{node}/reset", Trigger.Request())


def _request(kind: Any, service: str, request: Any) -> ServiceRequest:
    return ServiceRequest(kind, service, request, spoken(service))
