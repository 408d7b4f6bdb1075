"""Functions of the wall clock: the pace of ticks, and limits for log lines, which may be thousands in a second."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line

if TYPE_CHECKING:
    from rclpy.node import Node

_LINE_PERIOD = 5.0  # s
_FORGOTTEN = 30.0  # s without a fault, after which it is a new one
_NUMBER = re.compile(r"[-+]?\d[\d.e+-]*|\bnan\b|[-+]?\binf\b")


def check_factor(factor: float) -> float:
    """Return a real-time factor, checked."""
    # Not slower, because a sleep cannot be interrupted and a tick would take seconds.
    if not (factor == 0.0 or 0.001 <= factor <= 1000.0):
        raise ConfigError(
            f"real_time_factor is {factor}; accepted: a number in [0.001, 1000], or 0 for no pacing"
        )
    return factor


@dataclass
class PaceCounts:
    """What happened since the last `take`.

    Attributes:
        ticks: ticks done.
        late: ticks that began more than one period after they were due.
        dropped: ticks given up after a stall.
        worst: the longest time between two ticks, s.
        seconds: wall time since the last `take`.
    """

    ticks: int = 0
    late: int = 0
    dropped: int = 0
    worst: float = 0.0
    seconds: float = 0.0


class Pacer:
    """Lets tick after tick begin on a grid of the steady clock; catches up without drift.

    Args:
        period: simulated time of a tick, s.
        factor: simulated time per wall time; 0 does not wait at all.
        clock: the steady clock, s.
        sleep: waits for a number of seconds.
        forgiven: s behind that are caught up; more than that is given up, so that a stall is no burst of ticks.

    Attributes:
        factor: the one of the last tick.
    """

    def __init__(
        self,
        period: float,
        factor: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        *,
        forgiven: float = 0.1,
    ) -> None:
        self._period = period
        self._forgiven = forgiven
        self._clock = clock
        self._sleep = sleep
        self._next_factor = check_factor(factor)
        self._use_factor()
        self._counts = PaceCounts()
        self._counted_since = clock()

    def _use_factor(self) -> None:
        self.factor = self._next_factor
        self._step = self._period / self.factor if self.factor else 0.0
        self.restart()

    def restart(self) -> None:
        """Begin a new grid now: after a pause nothing is caught up."""
        self._anchor = self._last = self._clock()
        self._ticks = 0

    def change(self, factor: float) -> None:
        """Keep another pace from the next tick on; callable from every thread."""
        self._next_factor = check_factor(factor)

    def shift(self, seconds: float) -> None:
        """Move the grid, to a later time or, below 0, an earlier one."""
        self._anchor += seconds

    def wait(self) -> None:
        """Wait until the next tick is due."""
        if self._next_factor != self.factor:
            self._use_factor()
        counts = self._counts
        now = self._clock()
        if self._step:
            due = self._anchor + self._ticks * self._step
            if now < due:
                self._sleep(due - now)
                now = self._clock()
            if now - due > self._step:
                counts.late += 1
            if now - due > self._forgiven:
                counts.dropped += round((now - due) / self._step)
                self._anchor = now
                self._ticks = 0
            self._ticks += 1
        counts.ticks += 1
        counts.worst = max(counts.worst, now - self._last)
        self._last = now

    def take(self) -> PaceCounts:
        """Return the counts since the last call and begin new ones."""
        counts = self._counts
        self._counts = PaceCounts()
        now = self._clock()
        counts.seconds = now - self._counted_since
        self._counted_since = now
        return counts


class _Log:
    """Prints a line again only when it is due, and each as `one_line` has it.

    Args:
        announce: prints a line.
        clock: the steady clock, s.
    """

    def __init__(
        self, announce: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._announce = announce
        self._clock = clock
        self._due: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()


class ThrottledLog(_Log):
    """Prints a line at once, and the next one of its kind after five seconds, with the count of those in between.

    Lines of one kind are counted together, so that a number in the text does not make a new line of it.
    """

    def say(self, kind: str, text: str) -> None:
        """Print `text`, if the last line of this kind was printed at least five seconds ago."""
        now = self._clock()
        if now < self._due.get(kind, now):
            self._suppressed[kind] += 1
            return
        self._due[kind] = now + _LINE_PERIOD
        suppressed = self._suppressed.pop(kind, 0)
        self._announce(
            one_line(text) + (f" (and {counted(suppressed, 'time')} before)" if suppressed else "")
        )


class OnceLog(_Log):
    """Prints a line about a fault once, however often it comes; lines that differ in numbers alone are of one fault.

    One that has stayed away for half a minute is printed again. Callable from every thread.
    """

    def say(self, text: str) -> None:
        """Print `text`, unless this fault is known."""
        now = self._clock()
        fault = _NUMBER.sub("#", text)
        known = now < self._due.get(fault, now)
        self._due[fault] = now + _FORGOTTEN
        if not known:
            self._announce(one_line(text))


def error_log(node: Node) -> ThrottledLog:
    """Return a log of a node's errors, such as of messages that come by the hundred."""
    return ThrottledLog(lambda text: node.get_logger().error(text))
