"""When states for viewers and temperatures are published, with publishers that only keep what they get."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rx90_common.base.rates import Rates
from rx90_common.exchange.cdr import cdr_stamp_ns
from rx90_sim.node import publications

TICKS = 400_000  # a hundred seconds of simulated time at 4 kHz


Sent = tuple[int, str, float]


class KeepingPublisher:
    """Takes messages for so many who listen."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.listening = 1

    def get_subscription_count(self) -> int:
        """Return how many listen."""
        return self.listening

    def publish(self, message: Any) -> None:
        """Keep it."""
        self.messages.append(message)

    @property
    def sent(self) -> list[Sent]:
        """Return stamp, ns, name and value of temperatures."""
        heads = [(message.header, message.temperature) for message in self.messages]
        return [(head.stamp.sec * 10**9 + head.stamp.nanosec, head.frame_id, value) for head, value in heads]


def looked_on(monkeypatch: pytest.MonkeyPatch, pace: float, jitter: float = 0.0) -> list[int]:
    """Return the stamps, ns, published in 100 s of simulated time, every second sample late by a jitter, s."""
    node = SimpleNamespace(create_publisher=lambda *_: KeepingPublisher())
    states = tuple(np.zeros((3, 6)))
    plant = SimpleNamespace(
        joint_names=[f"joint_{k}" for k in range(6)],
        friction_names=[f"element_{k}" for k in range(6)],
        joint_states=lambda: states,
        friction_states=lambda: states,
    )
    sampled = publications.SampledStates(node, plant, Rates())  # type: ignore[arg-type]
    wall = 1e3
    monkeypatch.setattr(publications.time, "monotonic", lambda: wall)
    for tick in range(0, TICKS, 4):
        wall = 1e3 + tick / 4000.0 / pace + jitter * (tick // 40 % 2)
        sampled.publish_due(tick)
    (joints, friction) = sampled.publishers
    assert len(joints.messages) == len(friction.messages)
    return [cdr_stamp_ns(message) for message in joints.messages]


@pytest.mark.parametrize(("pace", "jitter"), [(0.1, 0.0), (1.0, 0.0), (1.0, 0.004)])
def test_each_is_published_at_the_pace_of_time(monkeypatch: pytest.MonkeyPatch, pace: float, jitter: float) -> None:
    """Up to real time there is one for each 10 ms of simulated time, also where every second one is 4 ms late."""
    stamps = looked_on(monkeypatch, pace, jitter)
    assert stamps == [10_000_000 * k for k in range(10_000)]


@pytest.mark.parametrize("pace", [2.5, 7.3, 400.0])
def test_thirty_a_second_where_time_hurries(monkeypatch: pytest.MonkeyPatch, pace: float) -> None:
    """Where simulated time runs faster there are thirty for each second of wall time, spread evenly."""
    stamps = looked_on(monkeypatch, pace)
    assert len(stamps) == pytest.approx(30.0 * 100.0 / pace, abs=2)
    gaps = [b - a for a, b in pairwise(stamps)]
    assert max(gaps[1:]) <= (pace / 0.3 + 10.0) * 1_000_000 * 10  # the last by no more than one sample
    assert {stamp % 10_000_000 for stamp in stamps} == {0}


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return the topic, at 4 Hz of 2000 ticks in a second, with an element and six windings that are warm."""
    publisher = KeepingPublisher()
    monkeypatch.setattr(publications, "publish", lambda *_: publisher)
    plant = SimpleNamespace(
        joint_names=[f"joint_{k}" for k in range(6)],
        friction_names=[f"element_{k}" for k in range(7)],
        temperatures=SimpleNamespace(elements=(2,), now=np.arange(30.0, 37.0)),
        constants={"winding": np.array([(1,)], dtype=[("used", int)])},
        state={"temperature": np.arange(50.0, 56.0)[None]},
    )
    topic = publications.Temperatures(None, plant, Rates(2000, 1000, 4))  # type: ignore[arg-type]
    return SimpleNamespace(topic=topic, publisher=publisher)


def moment(stamp_ns: int) -> list[Sent]:
    """Return what is to be sent of a moment: the element that gets warm, and each motor."""
    return [(stamp_ns, "element_2", 32.0), *((stamp_ns, f"motor_{k + 1}", 50.0 + k) for k in range(6))]


def test_each_temperature_is_sent_once(arm: SimpleNamespace) -> None:
    """At 4 Hz, stamped with simulated time; what is asked for again while time stands still is not repeated."""
    for tick in (*range(1001), 1000, 1000, *range(1001, 2001)):
        arm.topic.publish_due(tick)
    assert arm.publisher.sent == [one for k in range(5) for one in moment(k * 250_000_000)]


def test_a_reset_begins_again(arm: SimpleNamespace) -> None:
    """After a reset tick 0 is sent again, also where it was the last one sent; nothing while nobody listens."""
    for tick in (0, 1, 2, 0, 0, 1):
        arm.topic.publish_due(tick)
    assert arm.publisher.sent == moment(0) * 2
    arm.publisher.listening = 0
    for tick in range(2, 600):
        arm.topic.publish_due(tick)
    arm.publisher.listening = 1
    for tick in range(600, 1200):
        arm.topic.publish_due(tick)
    assert arm.publisher.sent == [*moment(0), *moment(0), *moment(500_000_000)]
