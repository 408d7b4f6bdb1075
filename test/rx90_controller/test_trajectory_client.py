"""A trajectory is sent when all that the graph shows to listen are matched."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy

from rx90_controller.node import trajectory_client
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
POINTS = TrajectoryPoints(np.array([1.0]), np.zeros((1, 6)), np.zeros((1, 6)), None)


class Graph:
    """A node, its publisher and its time: what is known and matched after each look, as told."""

    def __init__(self, looks: list[tuple[int, int]], timeout: float) -> None:
        self.now, self.timeout, self.said, self.sent_at = 0.0, timeout, list[str](), list[float]()
        self._looks: Iterator[tuple[int, int]] = iter(looks)
        self.known, self.have = next(self._looks)
        self.node = self
        self.topic_name, self.qos_profile = "/rx90_controller/joint_trajectory", QoSProfile(depth=1)

    def resolve_topic_name(self, name: str) -> str:
        """Return an absolute name."""
        return f"/{name}"

    def create_publisher(self, *_: object) -> Graph:
        """Return itself."""
        return self

    def get_subscriptions_info_by_topic(self, _: str) -> list[Any]:
        """Return who is known to listen; a reliable publisher suits all of them."""
        kinds = [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT] * 3
        return [SimpleNamespace(qos_profile=QoSProfile(depth=1, reliability=kind)) for kind in kinds[: self.known]]

    def get_subscription_count(self) -> int:
        """Return how many are matched."""
        return self.have

    def spin(self) -> None:
        """Let time pass, to the next look."""
        self.now += 0.05
        self.known, self.have = next(self._looks, (self.known, self.have))

    def publish(self, _: object) -> None:
        """Note when."""
        self.sent_at.append(self.now)

    def wait_for_all_acked(self, _: object) -> bool:
        """Confirm at once."""
        return True

    def say(self, text: str) -> None:
        """Note a line."""
        self.said.append(text)

    def check_interrupt(self) -> None:
        """Go on."""


@pytest.mark.parametrize(
    ("looks", "timeout", "sent_at", "said"),
    [
        ([(1, 1)], 30.0, 1.2, 0),
        # A recorder shows up in the graph after 0.2 s and is matched 0.3 s later.
        ([(1, 1)] * 4 + [(2, 1)] * 6 + [(2, 2)], 30.0, 1.7, 0),
        # It is stopped, and is never matched.
        ([(2, 1)], 2.0, 2.05, 1),
    ],
)
def test_it_waits_for_all_that_listen(
    monkeypatch: pytest.MonkeyPatch, looks: list[tuple[int, int]], timeout: float, sent_at: float, said: int
) -> None:
    """1.2 s after the last one was matched, or the timeout after somebody was not, which is said."""
    graph: Any = Graph(looks, timeout)
    monkeypatch.setattr(trajectory_client.time, "monotonic", lambda: graph.now)
    TrajectoryClient(graph, "rx90_controller").send(NAMES, POINTS)
    assert graph.sent_at == [pytest.approx(sent_at, abs=0.11)]
    assert [line.startswith("1 of 2 that listen to /rx90_controller/joint") for line in graph.said] == [True] * said
