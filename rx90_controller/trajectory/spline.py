"""Piecewise polynomials, and the motion along them on the ticks of the position loop: speed scaling and stops.

Along a path q(s) that is travelled at the rate r = ds/dt, the velocities are q' r and the accelerations
q'' r^2 + q' dr/dt (Bobrow, Dubowsky and Gibson 1985). A path within the acceleration limits at full speed is within
them at every lower constant rate; the reserve is used to change the rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.kernels.compiled import inlined, kernel

_BLOCK = 64  # ticks that are computed at once, at least
_HALVINGS = 20
_SLACK = 1e-3  # of the limit, as accelerations between two set-points of a path have it
_MAX_PAST_LAWS = 64  # changes of the rate that questions about the past may go back to


@dataclass(frozen=True)
class Spline:
    """A set-point for every time from the first knot on; after the last knot it rests there.

    Attributes:
        times: knots, s, shape (n,), increasing.
        coefficients: of powers 0 to 5 of the time since the knot, shape (n - 1, 6 powers, joints).
        final: position after the last knot, rad, shape (j,).
        blend_error: by how much it misses the points that it is to pass, at most, rad.
    """

    times: Array
    coefficients: Array
    final: Array
    blend_error: float = 0.0

    @property
    def duration(self) -> float:
        """Return the time of the last knot, s."""
        return float(self.times[-1])

    def sample(self, times: Array) -> Array:
        """Return set-points at `times`, s, shape (m,): position, velocity, acceleration, shape (m, 3, j)."""
        setpoints = np.empty((times.size, 3, self.final.size))
        sample_spline(self.times, self.coefficients, self.final, times, setpoints)
        return setpoints

    def bounds(self) -> tuple[Array, Array]:
        """Return bounds of positions, velocities and accelerations, shape (3, j) each; infinite for no numbers.

        Between its ends a polynomial lies within its control points as a Bezier curve (Farin 2002, chapter 5).
        """
        shape = 3, self.final.size
        low = np.full(shape, np.inf)
        high = np.full(shape, -np.inf)
        _control_points(self.coefficients, np.diff(self.times), low, high)
        return low, high


@kernel
def _control_points(coefficients: Array, span: Array, low: Array, high: Array) -> None:
    """Lower `low` and raise `high`, shape (3, j), to the control points of all pieces."""
    scaled = np.empty(6)
    for k in range(span.size):
        for j in range(low.shape[1]):
            for row in range(3):
                degree = 5 - row
                factor = 1.0
                for i in range(degree + 1):
                    # The derivative's coefficient, by the share of the span.
                    scaled[i] = coefficients[k, i + row, j] * factor
                    factor *= span[k]
                    for d in range(row):
                        scaled[i] *= i + row - d
                # Differences of the control points, upwards: b_m = sum of C(m, i)/C(degree, i) scaled_i.
                for m in range(degree + 1):
                    value = 0.0
                    share = 1.0
                    for i in range(m + 1):
                        value += share * scaled[i]
                        share *= (m - i) / (degree - i) if i < degree else 0.0
                    if not abs(value) < np.inf:
                        low[row, j] = -np.inf
                        high[row, j] = np.inf
                    low[row, j] = min(low[row, j], value)
                    high[row, j] = max(high[row, j], value)


@kernel
def sample_spline(
    knots: Array, coefficients: Array, final: Array, times: Array, setpoints: Array
) -> None:
    """Write the set-points at `times` into `setpoints`, shape (m, 3, j)."""
    last = knots.size - 1
    for m in range(times.size):
        t = times[m]
        if t >= knots[last]:
            for j in range(final.size):
                setpoints[m, 0, j] = final[j]
                setpoints[m, 1, j] = 0.0
                setpoints[m, 2, j] = 0.0
            continue
        k = max(np.searchsorted(knots, t, side="right") - 1, 0)
        s = t - knots[k]
        for j in range(final.size):
            c0 = coefficients[k, 0, j]
            c1 = coefficients[k, 1, j]
            c2 = coefficients[k, 2, j]
            c3 = coefficients[k, 3, j]
            c4 = coefficients[k, 4, j]
            c5 = coefficients[k, 5, j]
            setpoints[m, 0, j] = c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
            setpoints[m, 1, j] = c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))
            setpoints[m, 2, j] = 2 * c2 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))


def resting(position: Array) -> Spline:
    """Return the spline that holds a position, rad, shape (j,)."""
    return Spline(np.zeros(1), np.zeros((0, 6, position.size)), position)


def smooth(times: Array, position: Array, velocity: Array) -> Spline:
    """Return the cubic spline through the points whose acceleration is continuous from its begin to its end.

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, j).
        velocity: rad/s, shape (n, j); only the first and the last row count.
    """
    slopes = velocity.copy()
    _slopes(times, position, slopes)
    return interpolate(times, position, slopes, None)


@kernel
def _slopes(times: Array, position: Array, slopes: Array) -> None:
    """Fill the slopes of the C2 cubic between the first and the last row, shape (n, j) (de Boor 2001, chapter IV)."""
    # h1 s0 + 2 (h0 + h1) s1 + h0 s2 = 3 (h1 d0 + h0 d1), h: spans, d: differences of the positions by the spans.
    last = times.size - 1
    factor = np.zeros(times.size)
    for i in range(1, last):
        before = times[i] - times[i - 1]
        after = times[i + 1] - times[i]
        pivot = 2.0 * (before + after) - after * factor[i - 1]
        factor[i] = before / pivot
        for j in range(slopes.shape[1]):
            left = (position[i, j] - position[i - 1, j]) / before
            right = (position[i + 1, j] - position[i, j]) / after
            slopes[i, j] = (
                3.0 * (after * left + before * right) - after * slopes[i - 1, j]
            ) / pivot
    for i in range(last - 1, 0, -1):
        for j in range(slopes.shape[1]):
            slopes[i, j] -= factor[i] * slopes[i + 1, j]


def interpolate(
    times: Array, position: Array, velocity: Array, acceleration: Array | None
) -> Spline:
    """Return the spline through the points: cubic with velocities, quintic with velocities and accelerations.

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, j).
        velocity: rad/s, shape (n, j).
        acceleration: rad/s^2, shape (n, j).
    """
    h = np.diff(times)[:, None]
    coefficients = np.zeros((times.size - 1, 6, position.shape[1]))
    rise = np.diff(position, axis=0)
    v0 = velocity[:-1]
    v1 = velocity[1:]
    coefficients[:, 0] = position[:-1]
    coefficients[:, 1] = v0
    if acceleration is None:
        coefficients[:, 2] = (3 * rise / h - 2 * v0 - v1) / h
        coefficients[:, 3] = (-2 * rise / h + v0 + v1) / (h * h)
    else:
        a0 = acceleration[:-1]
        a1 = acceleration[1:]
        # What is left to do beyond constant acceleration a0, in position, velocity and acceleration.
        # Powers of h are products: NumPy's power rounds differently on different processors.
        square = h * h
        dp = rise - h * v0 - square * a0 / 2
        dv = v1 - v0 - h * a0
        da = a1 - a0
        coefficients[:, 2] = a0 / 2
        coefficients[:, 3] = (10 * dp / h - 4 * dv + h * da / 2) / square
        coefficients[:, 4] = (-15 * dp / h + 7 * dv - h * da) / (square * h)
        coefficients[:, 5] = (6 * dp / h - 3 * dv + h * da / 2) / (square * square)
    return Spline(times, coefficients, position[-1].copy())


def joined(first: Spline, at: float, second: Spline) -> Spline:
    """Return a spline that is the first one up to a time, s, and then the second one from its begin on."""
    before = first.times < at
    times = np.concatenate([first.times[before], at + second.times])
    coefficients = np.concatenate([_and_rest(first)[before], second.coefficients])
    blend_error = max(first.blend_error, second.blend_error)
    return Spline(times, coefficients, second.final, blend_error)


def _and_rest(spline: Spline) -> Array:
    """Return the coefficients of a spline and, behind its last knot, of the rest there, shape (n, 6, j)."""
    rest = np.zeros((1, 6, spline.final.size))
    rest[0, 0] = spline.final
    return np.concatenate([spline.coefficients, rest])


def remainder(spline: Spline, at: float) -> Spline:
    """Return the remainder of a spline from a time, s, on, with times counted from there."""
    knots = np.append(at, spline.times[spline.times > at])
    return Spline(knots - at, _expanded(spline, knots[:-1]), spline.final)


def merged(spline: Spline, other: Spline, joints: Mask) -> Spline:
    """Return a spline whose joints in a mask of shape (j,) are those of another one."""
    knots = np.union1d(spline.times, other.times)
    coefficients = np.where(joints, _expanded(other, knots[:-1]), _expanded(spline, knots[:-1]))
    return Spline(
        knots, coefficients, np.where(joints, other.final, spline.final), spline.blend_error
    )


def _expanded(spline: Spline, knots: Array) -> Array:
    """Return the coefficients of a spline by the times since other knots that include its own, shape (n, 6, j)."""
    piece = np.maximum(np.searchsorted(spline.times, knots, side="right") - 1, 0)
    old = _and_rest(spline)[piece]
    since = (knots - spline.times[piece])[:, None]
    coefficients = np.zeros_like(old)
    for power in range(6):
        # Taylor's formula, by Horner's scheme.
        for n in range(5, power - 1, -1):
            shifted = coefficients[:, power] * since
            coefficients[:, power] = shifted + math.comb(n, power) * old[:, n]
    return coefficients


# Paths that are followed.


class _Law:
    """Time and rate on a path from a tick on: the rate approaches a target, within accelerations, and stays there."""

    def __init__(
        self, motion: FollowedPath, tick: int, time: float, rate: float, wanted: float
    ) -> None:
        self.tick = tick
        self._spline = motion.path.spline
        self._limit = motion.limit
        self._period = motion.period
        self._wanted = wanted
        self._series = np.array([[time], [rate]])  # at its ticks
        self._settled = rate == wanted

    def at(self, ticks: Array) -> tuple[Array, Array, Array]:
        """Return times on the path, s, rates, and their changes, 1/s, at ticks, whole or not, shape (n,) each."""
        since = ticks - self.tick
        self._extend(int(since.max(initial=0.0)) + 2)
        times, rates = self._series
        last = times.size - 1
        row = np.clip(since.astype(np.int64), 0, last)
        ahead = (since - row) * self._period
        change = (rates[np.minimum(row + 1, last)] - rates[row]) / self._period
        return (
            times[row] + ahead * (rates[row] + 0.5 * ahead * change),
            rates[row] + ahead * change,
            change,
        )

    def point(self, tick: int) -> tuple[float, float]:
        """Return time, s, and rate at a tick, faster than `at`."""
        since = tick - self.tick
        self._extend(since + 1)
        row = min(since, self._series.shape[1] - 1)
        time, rate = self._series[:, row].tolist()
        return time + (since - row) * self._period * rate, rate

    def settles(self, within: int) -> int | None:
        """Return the ticks until the target rate, or the end of the path, is reached; None if they are more."""
        self._extend(within + 2)
        last = self._series.shape[1] - 1
        return last if self._settled and last <= within else None

    def _extend(self, count: int) -> None:
        """Compute `count` ticks, or as many as there are until the target rate is reached."""
        while not self._settled and self._series.shape[1] < count:
            # No more than that: otherwise the copied data would grow with the square of a long change's duration.
            block = max(_BLOCK, self._series.shape[1])
            series = np.empty((2, block + 1))
            series[:, 0] = self._series[:, -1]
            path = self._spline
            done = _advance(
                path.times,
                path.coefficients,
                path.final,
                self._limit,
                self._period,
                self._wanted,
                series,
            )
            self._settled = done < block
            self._series = np.concatenate([self._series, series[:, 1 : done + 1]], axis=1)


@kernel
def _advance(
    knots: Array,
    coefficients: Array,
    final: Array,
    limit: Array,
    period: float,
    wanted: float,
    series: Array,
) -> int:
    """Fill times and rates, shape (2, n), from their first entries on; return how many ticks the rate changes for."""
    here = np.empty((1, 3, final.size))
    there = np.empty((1, 3, final.size))
    at = np.empty(1)
    count: int = series.shape[1] - 1
    for k in range(count):
        time = series[0, k]
        rate = series[1, k]
        if rate == wanted or time >= knots[-1]:
            return k
        at[0] = time
        sample_spline(knots, coefficients, final, at, here)
        bound = _bound(here[0], rate, wanted, limit, period)
        # The rate may always stay; how far it may change is searched for between that and the bound.
        reachable = rate
        beyond = bound
        tried = bound
        for _ in range(_HALVINGS):
            at[0] = time + 0.5 * period * (rate + tried)
            sample_spline(knots, coefficients, final, at, there)
            if _follows(here[0], rate, there[0], tried, limit, period):
                reachable = tried
                if tried == bound:
                    break
            else:
                beyond = tried
            tried = 0.5 * (reachable + beyond)
        series[0, k + 1] = time + 0.5 * period * (rate + reachable)
        series[1, k + 1] = reachable
    return count


@inlined
def _bound(here: Array, rate: float, wanted: float, limit: Array, period: float) -> float:
    """Return how far the rate may approach its target with the accelerations q'' r^2 + q' dr/dt at its beginning."""
    change = (wanted - rate) / period
    for j in range(limit.size):
        slope = here[1, j]
        bend = here[2, j] * rate * rate
        acceleration_change = slope * change
        room = max(limit[j] - bend if acceleration_change > 0.0 else limit[j] + bend, 0.0)
        if abs(acceleration_change) > room:
            change *= room / abs(acceleration_change)
    if change == (wanted - rate) / period:
        return wanted
    return rate + change * period


@inlined
def _follows(
    before: Array, rate: float, after: Array, then: float, limit: Array, period: float
) -> bool:
    """Return whether velocities q' r change by no more than the limits, and the tick ends within the accelerations.

    Without the second condition the path's own acceleration could grow within the tick beyond the reserve.
    """
    follows = True
    change = (then - rate) / period
    for j in range(limit.size):
        step = after[1, j] * then - before[1, j] * rate
        end = after[2, j] * then * then + after[1, j] * change
        follows = (
            follows and abs(step) <= limit[j] * period and abs(end) <= limit[j] * (1.0 + _SLACK)
        )
    return follows


class Path(NamedTuple):
    """A spline, and the part of it that belongs to the newest trajectory.

    Attributes:
        spline: set-points at full speed, within the accelerations.
        begin: time at which that trajectory begins, s.
        last: time of its last point, s.
        stop: whether it is a stop.
    """

    spline: Spline
    begin: float
    last: float
    stop: bool = False


@dataclass
class FollowedPath:
    """A path that is followed from a position tick on.

    Attributes:
        start: the tick.
        path: from time 0 on.
        period: of the position loop, s.
        limit: accelerations of the joints, rad/s^2, shape (j,).
        fixed: whether it runs at full speed whatever the scaling is, as stops do.
        announced: whether its end has been announced.
        laws: of the time on the path, each from its tick on; at full speed before the first.
        before: the path without a trajectory that has been joined to it for later; None without one.
        oldest: the first tick for which `laws` are complete; None for `start`.
    """

    start: int
    path: Path
    period: float
    limit: Array
    fixed: bool = False
    announced: bool = False
    laws: list[_Law] = field(default_factory=list)
    before: Path | None = None
    oldest: int | None = None

    @property
    def end(self) -> int:
        """Return the first position tick at which it rests, at full speed."""
        # The rounding of a duration makes no tick more.
        return self.start + math.ceil(self.path.spline.duration / self.period - 1e-6)

    def setpoints(self, tick: int, count: int) -> Array:
        """Return the set-points of `count` ticks from `tick` on, shape (count, 3, j)."""
        return self.states(np.arange(tick, tick + count, dtype=np.float64))

    def leading(self, tick: int, count: int) -> Array:
        """Return set-points whose accelerations lead to the velocities of the next ones, shape (count, 3, j).

        The law holds its torque until then, and would lag by half a period where the acceleration jumps at a set-point.
        """
        ahead = self.setpoints(tick, count + 1)
        ahead[:-1, 2] = np.diff(ahead[:, 1], axis=0) / self.period
        return ahead[:-1]

    def states(self, ticks: Array) -> Array:
        """Return the set-points at n ticks, whole or not, shape (n, 3, j)."""
        if not self.laws:
            return self.path.spline.sample((ticks - self.start) * self.period)
        times = (ticks - self.start) * self.period
        rates = np.ones(len(times))
        changes = np.zeros(len(times))
        pending = np.ones(len(times), dtype=bool)
        for law in reversed(self.laws):
            rows = pending & (ticks >= law.tick)
            times[rows], rates[rows], changes[rows] = law.at(ticks[rows])
            pending &= ~rows
            if not pending.any():
                break
        setpoints = self.path.spline.sample(times)
        slope = setpoints[:, 1].copy()
        rate = rates[:, None]
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
        """Return position and its derivatives by the time on the path at a tick, shape (3, j)."""
        entry: Array = self.path.spline.sample(np.array([self.at(tick)[0]]))[0]
        return entry

    def runs(self, tick: int) -> bool:
        """Return whether it is not at its end at a tick."""
        return self.at(tick)[0] < self.path.spline.duration

    def over(self, tick: int) -> bool:
        """Return whether it has come to its end by a tick."""
        return not self.runs(tick) if self.laws else tick >= self.end

    def halted(self, tick: int, most: int) -> Spline | None:
        """Return the motion to rest on the path from a tick on; None if it takes more than `most` ticks."""
        law = _Law(self, tick, *self.at(tick), 0.0)
        count = law.settles(most) if self.runs(tick) else 0
        if count is None:
            return None
        states = replace(self, laws=[law]).setpoints(tick, count + 1)
        states[-1, 1:] = 0.0
        if count == 0:
            return resting(states[0, 0])
        times = np.arange(count + 1, dtype=np.float64) * self.period
        return interpolate(times, states[:, 0], states[:, 1], states[:, 2])

    def delay(self, count: int) -> None:
        """Shift it by `count` ticks."""
        self.start += count
        self.oldest = None if self.oldest is None else self.oldest + count
        for law in self.laws:
            law.tick += count

    def go_at(self, wanted: float, tick: int, rate: float | None = None) -> None:
        """Let the rate approach a target from `rate`, None for the present one, from a tick, or its start, on."""
        begin = max(tick, self.start)
        time, present = self.at(begin)
        rate = present if rate is None else rate
        self.laws = [law for law in self.laws if law.tick < begin]
        if self.laws or not rate == wanted == 1.0:
            self.laws.append(_Law(self, begin, time, rate, wanted))
        if len(self.laws) > _MAX_PAST_LAWS:
            self.oldest = self.laws[1].tick
            del self.laws[0]

    def on(self, path: Path, before: Path | None = None) -> FollowedPath:
        """Return it on another path, whose past is the same."""
        return replace(self, path=path, before=before, laws=list(self.laws))
