"""A client of a simulation node's services and time."""

from __future__ import annotations

from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.client_node import ClientNode, spoken

_PAUSE = "rx90_sim/pause"


class SimulationClient:
    """Time of a simulation node.

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
        """Stop time, or let it run.

        Raises:
            ExchangeError: if the node does not do it.
        """
        request = SetBool.Request(data=paused)
        spoken(_PAUSE)(self._client.call(SetBool, _PAUSE, request))
