"""Ask the simulation node to pause, to step and to reset, and follow its time."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.client_node import ClientNode


class SimulationClient:
    """The services of a simulation node, each of which raises ExchangeError if it does not do what it is asked.

    Attributes:
        time: newest simulated time, s, brought up to date by `ClientNode.spin`.
    """

    def __init__(self, client: ClientNode) -> None:
        self._client = client
        self.time = 0.0
        client.node.create_subscription(Clock, "/clock", self._on_clock, 10)

    def _on_clock(self, message: Clock) -> None:
        self.time = message_time_ns(message.clock) / NANOSECONDS

    def pause(self, paused: bool) -> None:
        """Let time stand still, or run."""
        self._ask(SetBool, "rx90_sim/pause", SetBool.Request(data=paused))

    def step(self) -> None:
        """Pause, and run as many ticks as the simulation's parameter `step_ticks` says."""
        self._ask(Trigger, "rx90_sim/step", Trigger.Request())

    def reset(self) -> None:
        """Begin again at tick 0."""
        self._ask(Trigger, "rx90_sim/reset", Trigger.Request())

    def _ask(self, kind: Any, service: str, request: Any) -> None:
        answer = self._client.call(kind, service, request)
        if not answer.success:
            raise ExchangeError(f"{service}: {answer.message}")
