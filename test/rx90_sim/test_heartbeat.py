"""The samples that come again while time stands still, against a clock of the test's own."""

from __future__ import annotations

from rx90_sim.node.ticks import Heartbeat


def test_a_tick_that_does_not_end_is_repeated_a_few_times_a_second() -> None:
    """Ten minutes in one tick, asked about 20 times a second, give four repetitions a second; ticks that end, none."""
    now, beats = 0.0, []
    heartbeat = Heartbeat(lambda: beats.append(now), lambda: now)
    for tick in range(1000):
        heartbeat.beat(tick)
        now += 0.1
    assert beats == []
    begun = now
    while now < begun + 600.0:
        heartbeat.beat(1000)
        now += 0.05
    assert 3.3 * 600 < len(beats) <= 4 * 600
    assert beats[0] - begun < 0.5
