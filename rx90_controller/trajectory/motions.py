"""What runs and what waits: motions on the ticks of the position loop, and the speed at which they are followed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.joining import joined
from rx90_controller.trajectory.limits import JointLimits
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


class Progress(NamedTuple):
    """How far a trajectory is: time on its path from its begin, negative before, and that of its last point, s."""

    time: float
    last: float


class End(NamedTuple):
    """The position tick in which a motion has come to its end, and whether it was a stop."""

    tick: int
    stop: bool


class Motions:
    """One motion that runs or holds, and one that may wait for its start.

    Attributes:
        revision: changes whenever set-points that were sampled in advance may be out of date.
        factor: what `set_speed_scaling` was given last, 1 in the beginning.
    """

    def __init__(self, limits: JointLimits, period: float, hold: Array) -> None:
        """Hold `hold`, rad, shape (6,); `period` is that of the position loop, s."""
        self.limits = limits
        self.period = period
        self.revision = 0
        self.factor = 1.0
        self.reset(hold)

    def reset(self, hold: Array) -> None:
        """Drop every trajectory and hold a position, rad, shape (6,)."""
        rest = Path.of(resting(np.array(hold, dtype=np.float64)))
        self._current = FollowedPath(0, rest, self.period, announced=True)
        self._next: FollowedPath | None = None
        self.revision += 1

    def delay(self, count: int, now: int) -> None:
        """Shift the running trajectory by `count` ticks, which passed without set-points up to tick `now`.

        A trajectory that is to follow it is shifted as well, because it begins where the running one will then be. If
        the arm rests, it keeps its start tick, or starts now if that has passed.
        """
        self._promote(now - count)
        resting = not self._current.runs(now - count)
        self._current.delay(count)
        if self._next is not None:
            self._next.delay(max(now - self._next.start, 0) if resting else count)
        self.revision += 1

    def setpoints(self, tick: int, count: int = 1) -> Array:
        """Return the set-points of `count` position ticks from `tick` on, shape (count, 3, 6).

        Ticks must not go back to before the last `accept`.
        """
        if self._next is None:
            return self._current.setpoints(tick, count)
        head = min(max(self._next.start - tick, 0), count)
        before = self._current.setpoints(tick, head)
        return np.concatenate([before, self._next.setpoints(tick + head, count - head)])

    def moving(self, tick: int) -> bool:
        """Return whether a trajectory runs, is held on its path, or waits for its start at position tick `tick`."""
        return (self._next or self._current).runs(tick)

    def ended(self, tick: int) -> End | None:
        """Return when a trajectory or a stop has come to its end, once for each that does.

        To be called in every position tick. A trajectory that another one has replaced has no end.
        """
        self._promote(tick)
        motion = self._current
        if motion.announced or not motion.over(tick):
            return None
        motion.announced = True
        return End(tick if motion.laws else motion.end, motion.path.stop)

    def state(self, tick: float) -> Array:
        """Return the set-point of the running trajectory at a time in position ticks, whole or not, shape (3, 6).

        In the past as far as the running trajectory goes back, in the future as it is with the present scaling.

        Raises:
            TrajectoryError: for a time before that.
        """
        motion = self._effective(tick)
        if not tick >= motion.since:
            raise TrajectoryError(
                f"time {tick * self.period:.6g} s; accepted: from {motion.since * self.period:.6g} s on, where the "
                "running motion begins"
            )
        state: Array = motion.states(np.array([tick], dtype=np.float64))[0]
        return state

    def progress(self, tick: int) -> Progress:
        """Return how far the trajectory that was taken last is at a position tick."""
        motion = self._next or self._current
        return Progress(motion.at(tick)[0] - motion.path.begin, motion.path.last - motion.path.begin)

    def speed_scaling(self, tick: int) -> float:
        """Return the speed along the path at a position tick, as a share of the trajectory's own; at rest `factor`."""
        motion = self._effective(tick)
        return motion.at(tick)[1] if motion.runs(tick) else self.factor

    def set_speed_scaling(self, factor: float, now: int) -> None:
        """Follow trajectories at `factor` of their speed, in [0, 1], from position tick `now` on; 0 holds on the path.

        Also while one runs: the time on its path then runs slower or faster, as quickly as the accelerations allow.
        What waits behind a running motion comes later by as much as that one is slowed down; what waits at rest keeps
        its start. A stop that begins at once is not slowed down. It stays over `reset`.

        Raises:
            TrajectoryError: if the factor is not a number in [0, 1].
        """
        if not 0.0 <= factor <= 1.0:
            raise TrajectoryError(f"speed scaling {factor:g}; accepted: a number in [0, 1]")
        self._promote(now)
        if factor == self.factor:
            return
        self.factor = factor
        motion, waiting = self._effective(now), self._next
        acceleration = self.limits.acceleration
        if motion.runs(now) and not motion.fixed:
            if waiting is not None and motion is not waiting:
                self._current, self._next = motion.over_to(waiting.path, waiting.start), None
                motion = self._current
            motion.go_at(factor, acceleration, now)
        elif waiting is not None and motion is not waiting:
            waiting.go_at(factor, acceleration, waiting.start, 1.0 if motion.runs(waiting.start) else factor)
        self.revision += 1

    def _effective(self, tick: float) -> FollowedPath:
        """Return the motion whose set-point a tick gets."""
        return self._current if self._next is None or tick < self._next.start else self._next

    def _promote(self, tick: int) -> None:
        """Make a trajectory that began before position tick `tick` the running one."""
        if self._next is not None and self._next.start < tick:
            self._current, self._next = self._next, None

    def _base(self, now: int) -> FollowedPath:
        """Return the running motion without what waits for its start."""
        motion = self._current
        if motion.before is None or motion.at(now)[0] >= motion.path.begin:
            return motion
        base = motion.on(motion.before)
        base.go_at(self.factor, self.limits.acceleration, now)
        return base

    def _rate(self, base: FollowedPath, begin: int) -> float:
        """Return the rate at which something begins behind a motion: that of the motion, or `factor` from rest."""
        return base.at(begin)[1] if base.runs(begin) else self.factor

    def _follow(self, base: FollowedPath, path: Path, begin: int, rate: float | None) -> None:
        """Follow a path from a tick on, behind `base`, from a rate on; None for full speed whatever the scaling is."""
        self.revision += 1
        self._current, self._next = base, FollowedPath(begin, path, self.period, fixed=rate is None)
        if rate is not None:
            self._next.go_at(self.factor, self.limits.acceleration, begin, rate)
