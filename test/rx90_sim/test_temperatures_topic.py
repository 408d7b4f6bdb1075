"""When the temperatures of joints and windings are published, with a plant and a publisher that only keeps them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from rx90_common.base.rates import Rates
from rx90_sim.node import publications

TOLD = tuple[int, str, float]


class KeepingPublisher:
    """Takes messages for so many who listen."""

    def __init__(self) -> None:
        self.told: list[TOLD] = []
        self.listening = 1

    def get_subscription_count(self) -> int:
        """Return how many listen."""
        return self.listening

    def publish(self, message: publications.Temperature) -> None:
        """Keep stamp, ns, name and value."""
        head = message.header
        self.told.append((head.stamp.sec * 10**9 + head.stamp.nanosec, head.frame_id, message.temperature))


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return the topic, at 4 Hz of 2000 ticks in a second, with an element and six windings that are warm."""
    publisher = KeepingPublisher()
    monkeypatch.setattr(publications, "publish", lambda *_: publisher)
    plant = SimpleNamespace(
        friction_names=[f"element_{k}" for k in range(7)],
        temperatures=SimpleNamespace(elements=(2,), now=np.arange(30.0, 37.0)),
        constants={"winding": np.array([(1,)], dtype=[("used", int)])},
        state={"temperature": np.arange(50.0, 56.0)[None]},
    )
    topic = publications.Temperatures(None, plant, Rates(2000, 1000, 4))  # type: ignore[arg-type]
    return SimpleNamespace(topic=topic, publisher=publisher)


def moment(stamp_ns: int) -> list[TOLD]:
    """Return what is to be told of a moment: the element that gets warm, and each motor."""
    return [(stamp_ns, "element_2", 32.0), *((stamp_ns, f"motor_{k + 1}", 50.0 + k) for k in range(6))]


def test_each_moment_is_told_once(arm: SimpleNamespace) -> None:
    """At 4 Hz, stamped with simulated time; what is asked for again while time stands still is not repeated."""
    for tick in (*range(1001), 1000, 1000, *range(1001, 2001)):
        arm.topic.publish_due(tick)
    assert arm.publisher.told == [one for k in range(5) for one in moment(k * 250_000_000)]


def test_a_reset_begins_again(arm: SimpleNamespace) -> None:
    """After a reset tick 0 is told again, also where it was the last one told; nothing while nobody listens."""
    for tick in (0, 1, 2, 0, 0, 1):
        arm.topic.publish_due(tick)
    assert arm.publisher.told == moment(0) * 2
    arm.publisher.listening = 0
    for tick in range(2, 600):
        arm.topic.publish_due(tick)
    arm.publisher.listening = 1
    for tick in range(600, 1200):
        arm.topic.publish_due(tick)
    assert arm.publisher.told == [*moment(0), *moment(0), *moment(500_000_000)]
