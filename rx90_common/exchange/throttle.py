"""Log lines that may come thousands of times a second, throttled."""

from __future__ import annotations

import time
from collections.abc import Callable

from rx90_common.base.quoting import one_line

_PERIOD = 5.0  # s


class ThrottledLog:
    """Prints a line at once, and the next one of its kind after five seconds, with the count of those in between.

    Lines of one kind are counted together, so that a number in the text does not make a new line of it.

    Each is printed as `one_line` has it.

    Args:
        announce: prints a line.
        clock: the steady clock, s.
    """

    def __init__(self, announce: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._announce = announce
        self._clock = clock
        self._due: dict[str, float] = {}
        self._suppressed: dict[str, int] = {}

    def say(self, kind: str, text: str) -> None:
        """Print `text`, if the last line of this kind was printed at least five seconds ago."""
        now = self._clock()
        if now < self._due.get(kind, now):
            self._suppressed[kind] = self._suppressed.get(kind, 0) + 1
            return
        text = one_line(text)
        self._due[kind] = now + _PERIOD
        suppressed = self._suppressed.pop(kind, 0)
        self._announce(f"{text} (and {suppressed} times before)" if suppressed else text)
