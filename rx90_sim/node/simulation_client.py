"""A client of a simulation node's services and time."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.client_node import ClientNode, spoken

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
        self._ask(SetBool, "pause", SetBool.Request(data=paused))

    def step(self) -> None:
        """Pause, and run `step_ticks` ticks, a parameter of the simulation."""
        self._ask(Trigger, "step", Trigger.Request())

    def reset(self) -> None:
        """Begin again at tick 0."""
        self._ask(Trigger, "reset", Trigger.Request())

    def _ask(self, kind: Any, name: str, request: Any) -> None:
        service = f"{_NAME}/{name}"
        spoken(service)(self._client.call(kind, service, request))
