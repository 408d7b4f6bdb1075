"""While time stands still, the newest samples come again a few times a second: who asks then gets an answer too."""

from __future__ import annotations

import time
from collections.abc import Callable

_PERIOD = 0.25  # s on the wall clock


class Heartbeat:
    """Repeats what was published last for as long as the tick stays the same; for the thread that ticks.

    Latching would not do: only subscribers that ask for it are told, and those would get as many old samples as the
    queue of a recorder is deep.

    Args:
        repeat: publishes the newest samples again, to the bit.
        clock: the steady clock, s.
    """

    def __init__(self, repeat: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._repeat, self._clock = repeat, clock
        self._tick: int | None = None
        self._due = 0.0

    def beat(self, tick: int) -> None:
        """Repeat the samples if that is due; called again and again while tick `tick` does not end."""
        now = self._clock()
        if tick != self._tick:
            self._tick = tick
        elif now >= self._due:
            self._repeat()
        else:
            return
        self._due = now + _PERIOD
