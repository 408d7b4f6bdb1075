"""A run that is as fast as it goes, and those who listen to it, on a clock made by hand."""

from __future__ import annotations

import pytest

from rx90_common.exchange import listeners
from rx90_common.exchange.qos import STATE_QOS, TICK_QOS


class Topic:
    """A publisher whose messages arrive a while after somebody waits for it."""

    def __init__(self, slowness: float) -> None:
        self.slowness, self.now, self.sent, self.most = slowness, 0.0, 0, 0
        self.arrived_at: float | None = None

    def get_subscription_count(self) -> int:
        """Return that somebody listens."""
        return 1

    def wait_for_all_acked(self, timeout: object) -> bool:
        """Wait for the timeout, or until all has arrived."""
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
    waiting = listeners.Listeners([topic], state_ticks, lambda: False, lambda: topic.now)
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
    waiting = listeners.Listeners([topic], 4, lambda: interrupted, lambda: topic.now)
    for _ in range(TICK_QOS.depth):
        waiting.tick_done()
    assert 5.0 < topic.now < 7.0  # longer than the lease of a process that was killed
    before = topic.now
    answered = listeners.Listeners([], 4, lambda: False, lambda: topic.now)
    answered.add([topic], answering=1)
    for _ in range(TICK_QOS.depth):
        answered.tick_done()
    assert topic.now == before
    interrupted = True
    for _ in range(TICK_QOS.depth):
        waiting.tick_done()
    assert topic.now < before + 0.1
