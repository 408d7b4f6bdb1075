"""The set-point generator: holds a position, follows a trajectory, holds its last point."""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.spline import Spline, interpolate

_CHECK_BLOCK = 4096


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
        self._current = _resting(np.array(hold, dtype=np.float64))
        self._start = 0
        self._next: tuple[int, Spline] | None = None
        self.revision += 1

    def delay(self, count: int, now: int) -> None:
        """Shift the running trajectory by `count` ticks, which passed without set-points up to tick `now`.

        A trajectory that is to follow it is shifted as well, because it begins where the running one will then be. If
        the arm rests, it keeps its start tick, or starts now if that has passed.
        """
        self._promote(now - count)
        resting = (now - count - self._start) * self.period >= self._current.duration
        self._start += count
        if self._next is not None:
            start, spline = self._next
            self._next = max(start, now) if resting else start + count, spline
        self.revision += 1

    def setpoints(self, tick: int, count: int = 1) -> Array:
        """Return the set-points of `count` position ticks from `tick` on, shape (count, 3, 6).

        Ticks must not go back to before the last `accept`.
        """
        if self._next is None:
            return self._sample(self._current, self._start, tick, count)
        start, spline = self._next
        head = min(max(start - tick, 0), count)
        before = self._sample(self._current, self._start, tick, head)
        return np.concatenate([before, self._sample(spline, start, tick + head, count - head)])

    def moving(self, tick: int) -> bool:
        """Return whether a trajectory runs or waits for its start at position tick `tick`."""
        start, spline = self._next or (self._start, self._current)
        return (tick - start) * self.period < spline.duration

    def accept(self, points: TrajectoryPoints, now: int, start: int | None) -> int:
        """Take a trajectory; return the position tick at which it starts.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`.

        Raises:
            TrajectoryError: if it lies in the past, starts elsewhere than the arm is, or breaks a limit.
        """
        begin = now if start is None else start
        if begin < now:
            late = (now - begin) * self.period
            raise TrajectoryError(
                f"start time {begin * self.period:.6g} s is {late:.6g} s in the past; accepted: now or later"
            )
        self._promote(now)
        spline = self._connect(points, begin)
        self._check(spline, points.times, self._sample(self._current, self._start, begin, 1)[0, 0])
        self._next = (begin, spline)
        self.revision += 1
        return begin

    def _promote(self, tick: int) -> None:
        """Make a trajectory that began before position tick `tick` the running one."""
        if self._next is not None and self._next[0] < tick:
            (self._start, self._current), self._next = self._next, None

    def _sample(self, spline: Spline, start: int, tick: int, count: int) -> Array:
        ticks = np.arange(tick - start, tick - start + count)
        return spline.sample(np.asarray(ticks * self.period, dtype=np.float64))

    def _check(self, spline: Spline, knots: Array, held: Array) -> None:
        """Check the set-points of a trajectory, in blocks: a long one needs no memory of its own.

        An arm that was pushed beyond a limit, to `held`, may come back: from there on only inwards.
        """
        outside = self.limits.outside(held)
        allowed = np.where(outside > 0.0, outside + self.limits.start_tolerance, 0.0)
        last = math.ceil(spline.duration / self.period)
        for first in range(0, last, _CHECK_BLOCK):
            # The blocks share a set-point, so that the step from one to the next is checked, too.
            ticks = np.arange(first, min(first + _CHECK_BLOCK, last) + 1)
            times = np.asarray(ticks * self.period, dtype=np.float64)
            allowed = self.limits.check(spline.sample(times), times, knots, allowed)

    def _connect(self, points: TrajectoryPoints, begin: int) -> Spline:
        """Return the spline through the points, begun at the set-point the arm will have at tick `begin`."""
        held = self._sample(self._current, self._start, begin, 1)[0]
        if points.times[0] > 0:
            return interpolate(
                np.concatenate([[0.0], points.times]),
                np.vstack([held[0], points.position]),
                None if points.velocity is None else np.vstack([held[1], points.velocity]),
                None if points.acceleration is None else np.vstack([held[2], points.acceleration]),
            )
        gap = points.position[0] - held[0]
        joint = int(np.argmax(np.abs(gap)))
        if abs(gap[joint]) > self.limits.start_tolerance:
            raise TrajectoryError(
                f"point 0: {self.limits.names[joint]} starts at {points.position[0, joint]:.6g} rad, the "
                f"set-point there is {held[0, joint]:.6g} rad; accepted: within "
                f"{self.limits.start_tolerance:g} rad, or a first point later than the start"
            )
        return interpolate(points.times, points.position, points.velocity, points.acceleration)


def _resting(position: Array) -> Spline:
    return Spline(np.zeros(1), np.zeros((0, 6, 6)), position)
