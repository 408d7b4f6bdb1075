"""How often the states for those who look on are published, counted with a node that only counts."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from rx90_common.base.rates import Rates
from rx90_common.base.stamps import cdr_stamp_ns
from rx90_sim.node import publications

TICKS = 400_000  # a hundred seconds of simulated time at 4 kHz


class CountingPublisher:
    """Takes messages for one who listens."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def get_subscription_count(self) -> int:
        """One."""
        return 1

    def publish(self, message: bytes) -> None:
        """Keep it."""
        self.messages.append(message)


def looked_on(monkeypatch: pytest.MonkeyPatch, pace: float, jitter: float = 0.0) -> list[int]:
    """Return the stamps, ns, published in 100 s of simulated time, every second sample late by a jitter, s."""
    node = SimpleNamespace(create_publisher=lambda *_: CountingPublisher())
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
