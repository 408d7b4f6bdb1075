"""The newest message of topics, taken when somebody wants it: for those who look now and then and may miss some."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from rx90_common.exchange.subscribing import TakenByHand, never_called


class Newest:
    """A subscription that keeps the newest messages; others cost no processor time but the middleware's.

    Best effort: the publisher neither waits for this subscription nor sends again what it has missed.

    Args:
        node: owner; an executor may spin it.
        kind: class of the messages.
        topic: relative or absolute name.
        raw: take the bytes as they are.
        latched: also what was published before; then reliable.
        depth: how many are kept.
    """

    def __init__(
        self, node: Node, kind: Any, topic: str, *, raw: bool = False, latched: bool = False, depth: int = 1
    ) -> None:
        profile = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self._kind, self._raw, self._depth = kind, raw, depth
        self._subscription = node.create_subscription(
            kind, topic, never_called, profile, raw=raw, callback_group=TakenByHand()
        )

    @property
    def topic(self) -> str:
        """Return the resolved name of the topic."""
        return str(self._subscription.topic_name)

    @property
    def publishers(self) -> int:
        """Return how many publishers the topic has."""
        return int(self._subscription.get_publisher_count())

    def take_all(self) -> list[Any]:
        """Return the messages that came since the last call, as far as they were kept, the newest last."""
        messages = []
        for _ in range(self._depth):
            taken = self._subscription.handle.take_message(self._kind, self._raw)
            if taken is None:
                break
            messages.append(taken[0])
        return messages

    def take(self) -> Any:
        """Return the newest message that came since the last call, None if none did."""
        messages = self.take_all()
        return messages[-1] if messages else None
