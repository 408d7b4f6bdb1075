"""The set-point generator: holds a position, follows a trajectory, holds its last point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.ramps import stop, straight
from rx90_controller.trajectory.spline import Spline, interpolate

_CHECK_BLOCK = 4096


class Schedule(NamedTuple):
    """When an accepted trajectory runs, in position ticks, and by how much it misses its points at most, rad."""

    begin: int
    end: int
    miss: float


class Progress(NamedTuple):
    """How far a trajectory is: time on its path from its begin, negative before, and that of its last point, s."""

    time: float
    last: float


class End(NamedTuple):
    """The position tick in which a motion has come to its end, and whether it was a stop."""

    tick: int
    stop: bool


@dataclass
class _Motion:
    """A spline that begins at position tick `start`; `announced` once `ended` has returned its end."""

    start: int
    spline: Spline
    period: float
    stop: bool = False
    announced: bool = False

    @property
    def end(self) -> int:
        """Return the first position tick at which it rests."""
        return self.start + _ticks(self.spline, self.period)

    def setpoints(self, tick: int, count: int) -> Array:
        """Return the set-points of `count` ticks from `tick` on, shape (count, 3, 6)."""
        ticks = np.arange(tick - self.start, tick - self.start + count)
        return self.spline.sample(np.asarray(ticks * self.period, dtype=np.float64))

    def runs(self, tick: int) -> bool:
        """Return whether it is not at its end at a tick."""
        return (tick - self.start) * self.period < self.spline.duration


class TrajectoryGenerator:
    """Set-points q, dq/dt and d2q/dt2 on the ticks of the position loop.

    Time is counted in position ticks and never read from a clock. A trajectory replaces the running one at
    its start tick; a refused one leaves everything untouched.

    Attributes:
        revision: changes whenever set-points that were sampled in advance may be out of date.
    """

    def __init__(self, limits: JointLimits, period: float, hold: Array) -> None:
        """Hold `hold`, rad, shape (6,); `period` is that of the position loop, s."""
        self.limits = limits
        self.period = period
        self.revision = 0
        self.reset(hold)

    def reset(self, hold: Array) -> None:
        """Drop every trajectory and hold a position, rad, shape (6,)."""
        self._current = _Motion(0, _resting(np.array(hold, dtype=np.float64)), self.period, announced=True)
        self._next: _Motion | None = None
        self.revision += 1

    def delay(self, count: int, now: int) -> None:
        """Shift the running trajectory by `count` ticks, which passed without set-points up to tick `now`.

        A trajectory that is to follow it is shifted as well, because it begins where the running one will then be. If
        the arm rests, it keeps its start tick, or starts now if that has passed.
        """
        self._promote(now - count)
        resting = not self._current.runs(now - count)
        self._current.start += count
        if self._next is not None:
            self._next.start = max(self._next.start, now) if resting else self._next.start + count
        self.revision += 1

    def refined(self, ratio: int) -> TrajectoryGenerator:
        """Return a generator of the same motions whose ticks are `ratio` times as frequent."""
        period = self.period / ratio
        finer = TrajectoryGenerator(self.limits, period, self._current.spline.final)
        finer._current = replace(self._current, start=self._current.start * ratio, period=period)
        finer._next = self._next and replace(self._next, start=self._next.start * ratio, period=period)
        return finer

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
        """Return whether a trajectory runs or waits for its start at position tick `tick`."""
        return (self._next or self._current).runs(tick)

    def ended(self, tick: int) -> End | None:
        """Return when a trajectory or a stop has come to its end, once for each that does.

        To be called in every position tick. A trajectory that another one has replaced has no end.
        """
        self._promote(tick)
        motion = self._current
        if motion.announced or tick < motion.end:
            return None
        motion.announced = True
        return End(motion.end, motion.stop)

    def accept(self, points: TrajectoryPoints, now: int, start: int | None) -> Schedule:
        """Take a trajectory; return when it runs.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`.

        Raises:
            TrajectoryError: if it lies in the past, starts elsewhere than the arm is, or breaks a limit.
        """
        begin = self._begin(now, start)
        held = self._current.setpoints(begin, 1)[0]
        outside = self.limits.outside(held[0])
        # An arm that was pushed beyond a limit may come back: from there on only inwards.
        allowed = np.where(outside > 0.0, outside + self.limits.start_tolerance, 0.0)
        self.limits.check_points((points.position, points.velocity, points.acceleration), allowed)
        spline = _connect(points, held, self.limits)
        self.limits.check_start(held, spline.sample(np.zeros(1))[0], self.period)
        _check(spline, self.period, points.times, self.limits, allowed)
        return self._follow(begin, spline)

    def stop(self, now: int, start: int | None) -> Schedule:
        """Brake every joint to rest from tick `start` on, `now` for None, and hold; return when that happens.

        Raises:
            TrajectoryError: if it lies in the past.
        """
        begin = self._begin(now, start)
        position, velocity, _ = self._current.setpoints(begin, 1)[0]
        return self._follow(begin, stop(position, velocity, self.limits.acceleration), stopping=True)

    def set_speed_scaling(self, factor: float, now: int) -> None:
        """Follow trajectories at `factor` of their speed, in [0, 1], from position tick `now` on; 0 holds on the path.

        Also while one runs: the time on its path then runs slower or faster, as quickly as the accelerations allow.
        What waits behind a running motion comes later by as much as that one is slowed down; what waits at rest keeps
        its start. Stops are not slowed down. It stays over `reset`.

        Raises:
            TrajectoryError: if the factor is not a number in [0, 1].
        """
        raise NotImplementedError

    def speed_scaling(self, tick: int) -> float:
        """Return the speed along the path at a position tick, as a share of the trajectory's own.

        At rest it is what `set_speed_scaling` was given, 1 in the beginning.
        """
        raise NotImplementedError

    def halt(self, now: int) -> Schedule:
        """Come to rest on the path, within the accelerations, from position tick `now` on, and hold.

        Where the path leaves so little room that this would take more than three times as long as `stop`, it is
        `stop`. What waits for its start is dropped. Return when the stop begins and ends.
        """
        raise NotImplementedError

    def join(self, points: TrajectoryPoints, now: int, start: int | None, *, anywhere: bool) -> Schedule:
        """Take a trajectory from where the path then is, without a jump; return when it runs.

        As `accept`, but points that are not later than its begin are left out: those in the past, and one at the begin
        itself, which must be within the start tolerance unless `anywhere`. Joints that the points do not name hold, or
        with `anywhere` go on along the running trajectory.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`; may lie in the past.
            anywhere: whether points may be left out that the arm is not near to.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        raise NotImplementedError

    def state(self, tick: float) -> Array:
        """Return the set-point of the running trajectory at a time in position ticks, whole or not, shape (3, 6).

        In the past as far as the running trajectory goes back, in the future as it is with the present scaling.

        Raises:
            TrajectoryError: for a time before the begin of what is kept.
        """
        raise NotImplementedError

    def progress(self, tick: int) -> Progress:
        """Return how far the trajectory that was taken last is at a position tick."""
        raise NotImplementedError

    def _begin(self, now: int, start: int | None) -> int:
        begin = now if start is None else start
        if begin < now:
            late = (now - begin) * self.period
            raise TrajectoryError(
                f"start time {begin * self.period:.6g} s is {late:.6g} s in the past; accepted: now or later"
            )
        self._promote(now)
        return begin

    def _follow(self, begin: int, spline: Spline, *, stopping: bool = False) -> Schedule:
        self._next = _Motion(begin, spline, self.period, stopping)
        self.revision += 1
        return Schedule(begin, self._next.end, spline.miss)

    def _promote(self, tick: int) -> None:
        """Make a trajectory that began before position tick `tick` the running one."""
        if self._next is not None and self._next.start < tick:
            self._current, self._next = self._next, None


def _check(spline: Spline, period: float, knots: Array, limits: JointLimits, allowed: Array) -> None:
    """Check the set-points of a trajectory, in blocks, so that a long one takes no more memory than a short one."""
    last = _ticks(spline, period)
    for first in range(0, last, _CHECK_BLOCK):
        # The blocks share a set-point, so that the step from one to the next is checked, too.
        ticks = np.arange(first, min(first + _CHECK_BLOCK, last) + 1)
        times = np.asarray(ticks * period, dtype=np.float64)
        allowed = limits.check(spline.sample(times), times, knots, allowed)


def _connect(points: TrajectoryPoints, held: Array, limits: JointLimits) -> Spline:
    """Return the spline through the points, begun at the set-point that the arm then has, shape (3, 6)."""
    times, position, velocity, acceleration = points.times, points.position, points.velocity, points.acceleration
    later = times[0] > 0
    if later:
        times = np.concatenate([[0.0], times])
        position = np.vstack([held[0], position])
        velocity = None if velocity is None else np.vstack([held[1], velocity])
        acceleration = None if acceleration is None else np.vstack([held[2], acceleration])
    gap = position[0] - held[0]
    joint = int(np.argmax(np.abs(gap)))
    if abs(gap[joint]) > limits.start_tolerance:
        raise TrajectoryError(
            f"point 0: {limits.names[joint]} starts at {position[0, joint]:.6g} rad, the "
            f"set-point there is {held[0, joint]:.6g} rad; accepted: within "
            f"{limits.start_tolerance:g} rad, or a first point later than the start"
        )
    if velocity is None:
        return straight(times, position, held[1], limits, first=-1 if later else 0)
    return interpolate(times, position, velocity, acceleration)


def _ticks(spline: Spline, period: float) -> int:
    """Return how many position ticks a spline takes; the rounding of a duration makes no tick more."""
    return math.ceil(spline.duration / period - 1e-6)


def _resting(position: Array) -> Spline:
    return Spline(np.zeros(1), np.zeros((0, 6, 6)), position)
