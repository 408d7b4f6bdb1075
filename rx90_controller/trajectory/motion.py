"""A motion along a path: when it begins, and how the time on the path runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory.joining import joined
from rx90_controller.trajectory.path_time import PathTime
from rx90_controller.trajectory.spline import Spline, interpolate, resting

_KEPT = 64  # changes of the rate that questions about the past may go back to


class Path(NamedTuple):
    """A spline, and the part of it that the trajectory taken last has.

    Attributes:
        spline: set-points at full speed.
        begin: time at which that trajectory begins, s.
        last: time of its last point, s.
        stop: whether it is a stop.
    """

    spline: Spline
    begin: float
    last: float
    stop: bool = False

    @classmethod
    def of(cls, spline: Spline, last: float | None = None, *, stop: bool = False) -> Path:
        """Return a path that is one trajectory; its last point is at the end unless another time, s, is given."""
        return cls(spline, 0.0, spline.duration if last is None else last, stop)


@dataclass
class FollowedPath:
    """A path that is followed from a position tick on.

    Attributes:
        start: the tick.
        path: from time 0 on.
        period: of the position loop, s.
        fixed: whether it runs at full speed whatever the scaling is, as stops do.
        announced: whether its end has been told.
        laws: how the time on the path runs, each from its tick on; at full speed before the first.
        before: the path without the trajectory that has been joined to it for later, if that is so.
        oldest: the first tick for which `laws` are complete; None for `start`.
    """

    start: int
    path: Path
    period: float
    fixed: bool = False
    announced: bool = False
    laws: list[PathTime] = field(default_factory=list)
    before: Path | None = None
    oldest: int | None = None

    @property
    def since(self) -> int:
        """Return the first tick for which its past is known."""
        return self.start if self.oldest is None else self.oldest

    @property
    def end(self) -> int:
        """Return the first position tick at which it rests, at full speed."""
        # The rounding of a duration makes no tick more.
        return self.start + math.ceil(self.path.spline.duration / self.period - 1e-6)

    def setpoints(self, tick: int, count: int) -> Array:
        """Return the set-points of `count` ticks from `tick` on, shape (count, 3, 6)."""
        return self.states(np.arange(tick, tick + count, dtype=np.float64))

    def states(self, ticks: Array) -> Array:
        """Return the set-points at n ticks, whole or not, shape (n, 3, 6)."""
        times, rates, changes = self._times(ticks)
        setpoints = self.path.spline.sample(times)
        if self.laws:
            slope, rate = setpoints[:, 1].copy(), rates[:, None]
            # Without the signs of zeros.
            setpoints[:, 1] = slope * rate + 0.0
            setpoints[:, 2] = setpoints[:, 2] * (rate * rate) + slope * changes[:, None] + 0.0
        return setpoints

    def at(self, tick: int) -> tuple[float, float]:
        """Return the time on the path at a tick, s, and its rate."""
        for law in reversed(self.laws):
            if tick >= law.tick:
                return law.point(tick)
        return (tick - self.start) * self.period, 1.0

    def entry(self, tick: int) -> Array:
        """Return position and its derivatives by the time on the path at a tick, shape (3, 6)."""
        entry: Array = self.path.spline.sample(np.array([self.at(tick)[0]]))[0]
        return entry

    def runs(self, tick: int) -> bool:
        """Return whether it is not at its end at a tick."""
        return self.at(tick)[0] < self.path.spline.duration

    def over(self, tick: int) -> bool:
        """Return whether it has come to its end by a tick."""
        return not self.runs(tick) if self.laws else tick >= self.end

    def halted(self, tick: int, limit: Array, most: int) -> Spline | None:
        """Return the motion that comes to rest on the path from a tick on; None if that takes more than `most` ticks.

        Args:
            tick: at which it begins.
            limit: accelerations of the joints, rad/s^2, shape (6,).
            most: ticks that it may take.
        """
        time, rate = self.at(tick)
        spline = self.path.spline
        law = PathTime(spline, limit, self.period, tick=tick, time=time, rate=rate, wanted=0.0)
        count = law.settles(most) if self.runs(tick) else 0
        if count is None:
            return None
        halting = self.on(self.path)
        halting.laws = [law]
        states = halting.setpoints(tick, count + 1)
        states[-1, 1:] = 0.0
        if count == 0:
            return resting(states[0, 0])
        times = np.arange(count + 1, dtype=np.float64) * self.period
        return interpolate(times, states[:, 0], states[:, 1], states[:, 2])

    def refined(self, ratio: int) -> FollowedPath:
        """Return it at full speed, on ticks that are `ratio` times as frequent."""
        return replace(self, start=self.start * ratio, period=self.period / ratio, laws=[], oldest=None)

    def delay(self, count: int) -> None:
        """Shift it by `count` ticks."""
        self.start += count
        self.oldest = None if self.oldest is None else self.oldest + count
        for law in self.laws:
            law.tick += count

    def go_at(self, wanted: float, limit: Array, tick: int, rate: float | None = None) -> None:
        """Let the rate go to a wanted one from a tick on, within accelerations, rad/s^2, shape (6,).

        Args:
            wanted: the rate to go to.
            limit: the accelerations.
            tick: at which the rate begins to change; its start if that is later.
            rate: at this tick; None for what it is there by now.
        """
        begin = max(tick, self.start)
        time, present = self.at(begin)
        rate = present if rate is None else rate
        self.laws = [law for law in self.laws if law.tick < begin]
        if self.laws or not rate == wanted == 1.0:
            self.laws.append(
                PathTime(self.path.spline, limit, self.period, tick=begin, time=time, rate=rate, wanted=wanted)
            )
        if len(self.laws) > _KEPT:
            self.oldest = self.laws[1].tick
            del self.laws[0]

    def on(self, path: Path, before: Path | None = None) -> FollowedPath:
        """Return it on another path, whose past is the same."""
        return replace(self, path=path, before=before, laws=list(self.laws))

    def over_to(self, path: Path, tick: int) -> FollowedPath:
        """Return it going over to another path where it will, by its present rate, be at a tick."""
        at = self.at(tick)[0]
        return self.on(Path(joined(self.path.spline, at, path.spline), at, at + path.last, path.stop), self.path)

    def _times(self, ticks: Array) -> tuple[Array, Array, Array]:
        """Return times on the path, s, rates, and changes of the rates, 1/s, at n ticks, shape (n,) each."""
        times = (ticks - self.start) * self.period
        rates, changes = np.ones(len(times)), np.zeros(len(times))
        left = np.ones(len(times), dtype=bool)
        for law in reversed(self.laws):
            rows = left & (ticks >= law.tick)
            times[rows], rates[rows], changes[rows] = law.at(ticks[rows])
            left &= ~rows
            if not left.any():
                break
        return times, rates, changes
