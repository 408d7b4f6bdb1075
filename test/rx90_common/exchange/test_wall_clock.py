"""The pacer, throttled lines and waits for listeners against a clock made by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rx90_common.base.rates import Rates
from rx90_common.exchange.endpoints import STATE_QOS, TICK_QOS, Listeners
from rx90_common.exchange.pacing import Pacer, ThrottledLog
from rx90_common.exchange.topics import TimeMode

PERIOD = 0.00025


class Clock:
    """A clock that stands still but for sleeping, which oversleeps, and for work."""

    def __init__(self, oversleep: float = 0.0) -> None:
        self.now = 100.0
        self.oversleep = oversleep
        self.slept = 0

    def read(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.slept += 1
        self.now += seconds + self.oversleep


def pacer(clock: Clock, factor: float) -> Pacer:
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


@pytest.mark.parametrize(("stall", "caught_up"), [(0.020, True), (1.0, False)])
def test_a_delay_is_caught_up_and_a_long_stall_is_given_up(stall: float, caught_up: bool) -> None:
    """After 20 ms ticks follow without sleep until the grid is reached again; after 1 s the grid begins anew."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    for _ in range(10):
        paced.wait()
    clock.now += stall
    slept = clock.slept
    paced.wait()
    begun = clock.now
    for _ in range(79):
        paced.wait()
    assert (clock.slept == slept) == caught_up
    for _ in range(110):
        paced.wait()
    expected = 100.0 + 199 * PERIOD if caught_up else begun + 189 * PERIOD
    assert clock.now == pytest.approx(expected)
    counts = paced.take()
    assert counts.ticks == 200
    assert counts.seconds == pytest.approx(clock.now - 100.0)
    assert counts.worst == pytest.approx(stall, rel=0.05)
    dropped = 0 if caught_up else stall / PERIOD
    assert counts.dropped == pytest.approx(dropped, abs=12)
    assert (75 <= counts.late <= 80) if caught_up else (counts.late == 1)
    paced.wait()
    counts = paced.take()
    assert (counts.ticks, counts.dropped) == (1, 0)
    assert counts.seconds == pytest.approx(PERIOD)


def test_restart_catches_nothing_up_and_factor_zero_never_sleeps() -> None:
    """After a pause and `restart` the next tick is due at once and the one after it a period later; 0 is no pacing."""
    clock = Clock()
    paced = pacer(clock, 1.0)
    paced.wait()
    clock.now += 0.050
    paced.restart()
    start = clock.now
    for tick in range(5):
        paced.wait()
        assert clock.now - start == pytest.approx(tick * PERIOD)
    assert paced.take().late == 0
    paced.change(0.0)
    slept = clock.slept
    for _ in range(50):
        paced.wait()
    assert (clock.slept, paced.take().ticks) == (slept, 50)


def test_a_kind_of_line_comes_at_once_and_then_with_a_count() -> None:
    """Of a thousand lines within a second one is printed; five seconds later the next one tells of the others."""
    now, said = [10.0], []
    log = ThrottledLog(said.append, lambda: now[0])
    for k in range(1000):
        log.say("bad", f"bad {k}")
        now[0] += 0.001
    log.say("other", "other")
    assert said == ["bad 0", "other"]
    now[0] += 5.0
    log.say("bad", "bad again")
    now[0] += 5.0
    log.say("bad", "bad once more")
    assert said[2:] == ["bad again (and 999 times before)", "bad once more"]


class Topic:
    def __init__(self, slowness: float) -> None:
        self.slowness, self.now, self.sent, self.most = slowness, 0.0, 0, 0
        self.arrived_at: float | None = None

    def get_subscription_count(self) -> int:
        return 1

    def wait_for_all_acked(self, timeout: object) -> bool:
        seconds = timeout.nanoseconds * 1e-9  # type: ignore[attr-defined]
        if self.arrived_at is None:
            self.arrived_at = self.now + self.slowness
        self.now = min(self.now + seconds, max(self.now, self.arrived_at))
        if self.now < self.arrived_at:
            return False
        self.arrived_at, self.sent = None, 0
        return True


@pytest.mark.parametrize(("state_ticks", "depth"), [(4, TICK_QOS.depth), (1, STATE_QOS.depth)])
def test_no_more_is_sent_than_publishers_keep(state_ticks: int, depth: int) -> None:
    """However slow a listener is, what it has not got is fewer messages than its publisher keeps for it."""
    topic = Topic(slowness=3.0)
    waiting = Listeners([topic], state_ticks, lambda: False, lambda: topic.now)
    for _ in range(5 * depth):
        topic.sent += 1
        topic.most = max(topic.most, topic.sent)
        waiting.tick_done()
    assert depth / 2 < topic.most < depth
    assert topic.now > 5 * 3.0


def test_who_is_gone_or_who_interrupts_is_not_waited_for() -> None:
    """A listener that answers never holds a run up for some seconds; no request, and nobody who answers, does."""
    topic = Topic(slowness=1e9)
    interrupted = False
    waiting = Listeners([topic], 4, lambda: interrupted, lambda: topic.now)
    for _ in range(TICK_QOS.depth):
        waiting.tick_done()
    assert 5.0 < topic.now < 7.0  # longer than the lease of a process that was killed
    before = topic.now
    answered = Listeners([], 4, lambda: False, lambda: topic.now)
    answered.add([topic], answering=1)
    for _ in range(TICK_QOS.depth):
        answered.tick_done()
    assert topic.now == before
    interrupted = True
    for _ in range(TICK_QOS.depth):
        waiting.tick_done()
    assert topic.now < before + 0.1


def test_the_text_carries_mode_and_rates() -> None:
    """What is written can be read, also where a robot's name has two words."""
    for name in (None, "my arm"):
        mode = TimeMode("free_running", Rates(8000, 2000), name)
        assert TimeMode.parse(mode.text) == mode
