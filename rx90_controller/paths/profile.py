"""The motion along a path within limits of the speed, place by place: trapezoids, rounded where the jerk is limited.

Between two stops the square of the speed is the largest function within all limits whose slope the acceleration
allows in both directions; it is piecewise linear in the distance, and computed forwards and backwards over the places
at which a limit changes.

A limited jerk replaces that motion by its mean over a time tau (Biagiotti and Melchiorri 2012, "FIR filters for online
trajectory planning with time- and frequency-domain specifications"): steps of the acceleration become ramps over tau,
speed and acceleration grow nowhere. The mean looks back, so each limit is first widened by half of the distance
travelled in tau on both sides, and each stop lasts tau.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.lines.task import PathMotion, Vector

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

_SHORTEST_PHASE = 1e-9  # s
_BISECTIONS = 60


class SpeedLimit(NamedTuple):
    """The largest speed, m/s, and acceleration along the path, m/s², from one distance to another, m."""

    begin: float
    end: float
    speed: float
    acceleration: float = math.inf


@dataclass(frozen=True, eq=False)
class LimitedProfile:
    """A motion from rest to rest.

    Attributes:
        limits: of the speed; they cover the path in its order.
        stops: distances, m, at which the motion rests for an instant, its start and end among them.
        acceleration: largest one along the path, m/s².
        jerk: largest one along the path, m/s³; infinite for trapezoids.
    """

    limits: tuple[SpeedLimit, ...]
    stops: Vector
    acceleration: float
    jerk: float = math.inf

    @property
    def length(self) -> float:
        """Return the length of the path, m."""
        return self.stops[-1]

    @cached_property
    def _steepest(self) -> float:
        """Return the largest acceleration that is used: beyond it a limited jerk reaches no speed sooner."""
        return min(self.acceleration, math.sqrt(max(one.speed for one in self.limits) * self.jerk))

    @cached_property
    def _motion(self) -> PPoly:
        """Return the distance over the time."""
        from scipy.interpolate import PPoly  # takes a while

        steps = (1.0, 2.0) if math.isfinite(self.jerk) else (0.0,)
        for step in steps:  # ramps up and down within the mean's time have twice the jump of one
            mean = step * self._steepest / self.jerk
            phases: list[
                tuple[float, float, float, float]
            ] = []  # duration, distance, speed, acceleration
            for begin, end in pairwise(self.stops):
                phases += self._between(begin, end, mean)
                phases.append((mean, end, 0.0, 0.0))
            rows = np.array([phase for phase in phases[:-1] if phase[0] > _SHORTEST_PHASE])
            times = np.append(0.0, np.cumsum(rows[:, 0]))
            if mean == 0.0:
                return PPoly(np.array([0.5 * rows[:, 3], rows[:, 2], rows[:, 1]]), times)
            at = np.sort(np.concatenate([times, times + mean]))
            steps_of = np.pad(rows[:, 3], 1)
            now = steps_of[np.searchsorted(times, at + _SHORTEST_PHASE / 2.0)]
            before = steps_of[np.searchsorted(times, at - mean + _SHORTEST_PHASE / 2.0)]
            jerks = (now - before) / mean
            if np.abs(jerks).max() <= self.jerk * (1.0 + 1e-9):
                break
        return PPoly(jerks[None, :-1], at).antiderivative(3)

    def _between(
        self, begin: float, end: float, mean: float
    ) -> list[tuple[float, float, float, float]]:
        """Return the phases from one stop to the next."""
        widened = []
        for one in self.limits:
            if one.begin < end and one.end > begin:
                way = 0.5 * mean * one.speed
                widened.append(
                    one._replace(begin=max(begin, one.begin - way), end=min(end, one.end + way))
                )
        edges = np.unique([begin, end, *(place for one in widened for place in one[:2])])
        middles = 0.5 * (edges[1:] + edges[:-1])
        most = np.full(len(middles), np.inf)
        most_acceleration = np.full(len(middles), self._steepest)
        for one in widened:
            rows = (middles > one.begin) & (middles < one.end)
            most[rows] = np.minimum(most[rows], one.speed**2)
            most_acceleration[rows] = np.minimum(most_acceleration[rows], one.acceleration)
        ways = np.diff(edges)
        squares = np.pad(np.minimum(most[1:], most[:-1]), 1)
        gains = 2.0 * most_acceleration * ways
        for k, gain in enumerate(gains):
            squares[k + 1] = min(squares[k + 1], squares[k] + gain)
        for k in range(len(ways) - 1, -1, -1):
            squares[k] = min(squares[k], squares[k + 1] + gains[k])
        phases = []
        for k, (way, a) in enumerate(zip(ways, most_acceleration, strict=True)):
            first = squares[k]
            last = squares[k + 1]
            peak = min(most[k], 0.5 * (first + last) + a * way)
            v0 = math.sqrt(first)
            v = math.sqrt(peak)
            v1 = math.sqrt(last)
            up = 0.5 * (peak - first) / a
            down = 0.5 * (peak - last) / a
            even = max(way - up - down, 0.0)
            phases.append(((v - v0) / a, edges[k], v0, a))
            phases.append((even / v, edges[k] + up, v, 0.0))
            phases.append(((v - v1) / a, edges[k + 1] - down, v, -a))
        return phases

    @property
    def duration(self) -> float:
        """Return the duration from rest to rest, s."""
        return float(self._motion.x[-1])

    @property
    def peak_speed(self) -> float:
        """Return the highest speed reached, m/s; with a limited jerk at the ends of its ramps."""
        return float(self.sample(np.array(self.corners)).speed.max())

    @property
    def corners(self) -> Vector:
        """Return the times at which the acceleration jumps, or its slope, s."""
        times = self._motion.x
        distinct = np.append(True, np.diff(times) > 1e-6)
        distinct[-1] = True
        return tuple(times[distinct].tolist())

    def sample(self, times: Array) -> PathMotion:
        """Return the motion at `times`, s, shape (n,): at rest before 0 and after the duration."""
        t = np.asarray(times, dtype=np.float64)
        over = t >= self.duration
        begun = t > 0.0
        inside = np.clip(t, 0.0, self.duration)
        distance = np.clip(self._motion(inside), 0.0, self.length)
        distance = np.where(over, self.length, np.where(begun, distance, 0.0))
        # A trapezoid has its accelerations at both ends, too.
        moves = begun & ~over if math.isfinite(self.jerk) else inside == t
        rates = (np.where(moves, self._motion(inside, order), 0.0) for order in (1, 2))
        return PathMotion(distance, *rates)

    def speed_at(self, distance: Array) -> Array:
        """Return the speed in m/s at `distance` m from the start, shape (n,)."""
        return self.sample(self.times_at(distance)).speed

    def times_at(self, distance: Array) -> Array:
        """Return the first times, s, at which distances (n,) m are reached."""
        low = np.zeros(len(distance))
        high = np.full(len(distance), self.duration)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            there = self.sample(middle).distance >= distance
            low = np.where(there, low, middle)
            high = np.where(there, middle, high)
        return high
