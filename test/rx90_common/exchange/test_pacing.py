"""The pacer against a clock made by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.base.errors import ConfigError
from rx90_common.exchange.pacing import Pacer

PERIOD = 0.00025


class Clock:
    """A clock that stands still but for sleeping, which oversleeps, and for work."""

    def __init__(self, oversleep: float = 0.0) -> None:
        self.now = 100.0
        self.oversleep = oversleep
        self.slept = 0

    def read(self) -> float:
        """Return the time."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let the time pass."""
        assert seconds > 0.0
        self.slept += 1
        self.now += seconds + self.oversleep


def pacer(clock: Clock, factor: float) -> Pacer:
    """Return a pacer of 4 kHz on this clock."""
    return Pacer(PERIOD, factor, clock.read, clock.sleep)


@given(st.sampled_from([0.01, 0.1, 0.5, 1.0, 3.0]), st.floats(0.0, 0.9), st.floats(0.0, 0.9))
def test_rate_is_held_without_drift(factor: float, oversleep: float, work: float) -> None:
    """However long sleeping and working take within a period, tick n begins within one period of n periods."""
    step = PERIOD / factor
    clock = Clock(oversleep * step)
    paced = pacer(clock, factor)
    for tick in range(200):
        paced.wait()
        assert -1e-9 <= clock.now - 100.0 - tick * step <= step
        clock.now += work * step


def test_a_delay_is_caught_up() -> None:
    """After 20 ms of delay ticks follow without sleep until the grid is reached again, and are counted late."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    for _ in range(10):
        paced.wait()
    clock.now += 0.020
    slept = clock.slept
    for _ in range(80):
        paced.wait()
    assert clock.slept == slept
    for _ in range(110):
        paced.wait()
    assert clock.now == pytest.approx(100.0 + 199 * PERIOD)
    counts = paced.take()
    assert (counts.ticks, counts.dropped) == (200, 0)
    assert 75 <= counts.late <= 80
    assert counts.worst == pytest.approx(0.020, rel=0.05)


def test_a_long_stall_is_given_up_and_counted() -> None:
    """After a stall of 1 s the grid begins anew instead of a burst of 4000 ticks, and those given up are counted."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    paced.wait()
    clock.now += 1.0
    paced.wait()
    start = clock.now
    for _ in range(4):
        paced.wait()
    assert clock.now - start == pytest.approx(4 * PERIOD)
    assert paced.take().dropped == pytest.approx(4000, abs=2)


def test_counts_are_those_since_the_last_call() -> None:
    """Each `take` gives the counts and the wall time of its own interval."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    for ticks in (100, 40):
        start = clock.now
        for _ in range(ticks):
            paced.wait()
        counts = paced.take()
        assert counts.ticks == ticks
        assert counts.seconds == pytest.approx(clock.now - start)


def test_restart_catches_nothing_up() -> None:
    """After a pause and `restart` the next tick is due at once and the one after it a period later."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    paced.wait()
    clock.now += 0.05
    paced.restart()
    start = clock.now
    for tick in range(5):
        paced.wait()
        assert clock.now - start == pytest.approx(tick * PERIOD)
    assert paced.take().late == 0


def test_factor_zero_never_sleeps() -> None:
    """Without pacing no time is spent, and ticks are still counted."""
    clock = Clock()
    paced = pacer(clock, 0.0)
    for _ in range(50):
        paced.wait()
        clock.now += 0.001
    assert clock.slept == 0
    assert paced.take().ticks == 50


@pytest.mark.parametrize("factor", [-1.0, 0.0001, 1001.0, float("nan"), float("inf")])
def test_impossible_factors_are_refused(factor: float) -> None:
    """A factor that cannot be paced is refused with the value and the accepted range."""
    with pytest.raises(ConfigError, match=r"real_time_factor is .*accepted"):
        Pacer(PERIOD, factor)
