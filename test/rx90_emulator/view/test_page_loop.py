"""The loop of a page: how often it calls its parts, and that a signal does not stop it."""

from __future__ import annotations

import queue
import signal
import threading
import time
from types import FrameType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser")

from rx90_emulator.view import page as page_module


class Clock:
    """Time that goes on by what is waited for, s; stands for the queue of what is handed over, too."""

    def __init__(self) -> None:
        self.now = 100.0

    def get(self, timeout: float) -> None:
        """Wait in vain."""
        self.now += timeout
        raise queue.Empty


def test_while_time_hurries_calls_come_a_third_as_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of calls every 0.1 s, in 6 s of a hurry every third is made, and later all, on time."""
    clock, made = Clock(), list[float]()
    page = page_module.Page("test", port=0)
    monkeypatch.setattr(page_module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(page, "_handed_over", clock)
    page.every(0.1, made.append, hurries=lambda now: now < 105.95)
    page.run(until=lambda: clock.now >= 110.02)
    page.close()
    expected = np.concatenate([np.arange(100.0, 106.1, 0.3), np.arange(106.1, 110.05, 0.1)])
    np.testing.assert_allclose(made, expected, atol=1e-6)


def test_a_signal_that_is_handled_beyond_the_wait_does_not_stop_the_page() -> None:
    """It waits 50 ms at most for what is handed over, also where a signal takes longer than what is left of them."""
    page = page_module.Page("test", port=0)
    handled, helped = [], threading.Event()

    def handle(_number: int, _frame: FrameType | None) -> None:
        handled.append(time.monotonic())
        time.sleep(0.1)

    rescue = threading.Timer(10.0, lambda: page.later(helped.set))
    rescue.start()
    before = signal.signal(signal.SIGALRM, handle)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        page.run(until=lambda: bool(handled) and time.monotonic() > handled[0] + 0.5)
    finally:
        signal.signal(signal.SIGALRM, before)
        rescue.cancel()
        page.close()
    assert not helped.is_set()
