"""Lines that may come thousands of times a second, printed now and then with their count."""

from __future__ import annotations

import time
from collections.abc import Callable

_PERIOD = 5.0


class Occasionally:
    """Prints a line at once, and again after a while with the count of those that were left out in between.

    Lines of one kind are counted together, so that a number in the text does not make a new line of it.

    Args:
        announce: prints a line.
        clock: the steady clock, s.
    """

    def __init__(self, announce: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._announce = announce
        self._clock = clock
        self._due: dict[str, float] = {}
        self._left_out: dict[str, int] = {}

    def say(self, kind: str, text: str) -> None:
        """Print `text`, if the last line of this kind was printed at least five seconds ago."""
        now = self._clock()
        if now < self._due.get(kind, now):
            self._left_out[kind] = self._left_out.get(kind, 0) + 1
            return
        self._due[kind] = now + _PERIOD
        left_out = self._left_out.pop(kind, 0)
        self._announce(f"{text} (and {left_out} times before)" if left_out else text)
