"""Keep ticks in step with the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rx90_common.base.errors import ConfigError

_FORGIVEN = 0.1  # s behind that are caught up; more than that is given up, so that a stall is no burst of ticks


def check_factor(factor: float) -> None:
    """Refuse a factor that no pacer keeps.

    Raises:
        ConfigError: with what is accepted.
    """
    # Not slower, because a sleep cannot be interrupted and a tick would take seconds.
    if not (factor == 0.0 or 0.001 <= factor <= 1000.0):
        raise ConfigError(f"real_time_factor is {factor}; accepted: a number in [0.001, 1000], or 0 for no pacing")


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

    Attributes:
        factor: the one of the last tick.

    Raises:
        ConfigError: as `check_factor`.
    """

    def __init__(
        self,
        period: float,
        factor: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        check_factor(factor)
        self._period = period
        self.factor = self._next_factor = factor
        self._step = period / factor if factor else 0.0
        self._clock, self._sleep = clock, sleep
        self.restart()
        self._counts = PaceCounts()
        self._taken = clock()

    def restart(self) -> None:
        """Begin a new grid now: after a pause nothing is caught up."""
        self._anchor = self._last = self._clock()
        self._ticks = 0

    def change(self, factor: float) -> None:
        """Keep another pace from the next tick on; callable from every thread.

        Raises:
            ConfigError: as `check_factor`.
        """
        check_factor(factor)
        self._next_factor = factor

    def shift(self, seconds: float) -> None:
        """Move the grid, to a later time or, below 0, an earlier one."""
        self._anchor += seconds

    def wait(self) -> None:
        """Wait until the next tick is due."""
        if self._next_factor != self.factor:
            self.factor = self._next_factor
            self._step = self._period / self.factor if self.factor else 0.0
            self.restart()
        counts = self._counts
        now = self._clock()
        if self._step:
            due = self._anchor + self._ticks * self._step
            if now < due:
                self._sleep(due - now)
                now = self._clock()
            if now - due > self._step:
                counts.late += 1
            if now - due > _FORGIVEN:
                counts.dropped += round((now - due) / self._step)
                self._anchor, self._ticks = now, 0
            self._ticks += 1
        counts.ticks += 1
        counts.worst = max(counts.worst, now - self._last)
        self._last = now

    def take(self) -> PaceCounts:
        """Return the counts since the last call and begin new ones."""
        counts, self._counts = self._counts, PaceCounts()
        now = self._clock()
        counts.seconds, self._taken = now - self._taken, now
        return counts
