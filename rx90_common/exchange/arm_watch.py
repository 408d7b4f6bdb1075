"""Watch a running arm by its public topics, without making it wait."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.joint_state_parser import parse_joint_state
from rx90_common.exchange.newest import Newest

_NODES = 20  # that may all speak at once


class JointSample(NamedTuple):
    """A message of type JointState: simulated time in s, and arrays in the order of the names asked for."""

    time: float
    position: Array
    velocity: Array
    effort: Array


class NodeStatus(NamedTuple):
    """What a node says of itself once a second: 0 good, 1 warning, 2 error, 3 stale."""

    level: int
    message: str
    values: dict[str, str]


class SampleTopic:
    """The newest sample of a topic of type JointState with known names.

    Attributes:
        problem: why the newest message is not one of this robot; empty if it is.
    """

    def __init__(self, node: Node, topic: str, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._newest = Newest(node, JointState, topic, raw=True)
        self.problem = ""

    @property
    def publishers(self) -> int:
        """Return how many publishers the topic has."""
        return self._newest.publishers

    def take(self) -> JointSample | None:
        """Return the newest sample that came since the last call; None if none did, or it is of another robot."""
        raw = self._newest.take()
        if raw is None:
            return None
        try:
            stamp, arrays = parse_joint_state(raw, self._names)
            position, velocity, effort = arrays
            if position is None or velocity is None or effort is None:
                raise ExchangeError("position, velocity or effort is empty; accepted: all three")
        except ExchangeError as error:
            self.problem = f"{self._newest.topic}: {error}"
            return None
        self.problem = ""
        return JointSample(stamp / NANOSECONDS, position, velocity, effort)


class DiagnosticsTopic:
    """The newest word of each node on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._newest = Newest(node, DiagnosticArray, "/diagnostics", depth=_NODES)
        self.status: dict[str, NodeStatus] = {}

    def take(self) -> None:
        """Bring `status` up to date."""
        for status in (status for message in self._newest.take_all() for status in message.status):
            values = {pair.key: pair.value for pair in status.values}
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self.status[status.name] = NodeStatus(level, status.message, values)
