"""The limits of set-points, and paths within them through the points of a trajectory: splines, lines, stops.

A straight line from point to point would need jumps of the velocity. An arm would lag behind them, and pass the point
by about v^2/(2 a). Each change of velocity therefore becomes a ramp of constant acceleration, as short as the limits
allow and of the same duration in all joints, so that the motion stays straight: linear segments with parabolic blends
(Craig 2005, section 7.3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import ConfigError, TrajectoryError
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.spline import Spline, interpolate, resting, smooth

# A spline that should run exactly at a limit, or end on it, may miss it by rounding.
_SLACK = 1e-9
# rad; planners clip to limits that were printed, or were held as angles of their own
_POSITION_SLACK = 1e-6
# Times in messages are whole nanoseconds, which changes an acceleration over some milliseconds by some millionths.
_ACCELERATION_SLACK = 1e-5  # of the limit
# The largest acceleration lies between two set-points, and may be a little more than the largest set-point.
_BETWEEN_SLACK = 1e-3  # of the limit
_CHECKED_AT_ONCE = 4096  # set-points
_LONGEST_MOVE = 100.0  # s: an arm that does not come to a point in it never does
_MOVE_PRECISION = 1.005  # by how much the stated time for a move may be longer than the least one


class _Quantity(NamedTuple):
    """A quantity with its limits, of shape (j,) or with a row for each value."""

    what: str
    unit: str
    low: Array
    high: Array
    slack: Array | float = _SLACK

    def first_outside(self, values: Array) -> tuple[int, int] | None:
        """Return row and joint of the first value, of shape (m, j), that is not within the limits, or no number."""
        within = (values >= self.low - self.slack) & (values <= self.high + self.slack)
        if within.all():
            return None
        row, joint = np.argwhere(~within)[0].tolist()
        return row, joint

    def accepted(self, row: int, joint: int) -> str:
        """Return the limits of a joint in a row."""
        low = self.low if self.low.ndim == 1 else self.low[row]
        high = self.high if self.high.ndim == 1 else self.high[row]
        return f"[{low[joint]:.6g}, {high[joint]:.6g}]"


@dataclass(frozen=True)
class JointLimits:
    """Limits of j joints, each of shape (j,): positions in rad, speeds in rad/s, accelerations in rad/s^2.

    Attributes:
        start_tolerance: how far, rad, a trajectory may start from the set-point that is held.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    start_tolerance: float

    def __post_init__(self) -> None:
        if (
            np.any(self.lower >= self.upper)
            or np.any(self.velocity <= 0)
            or np.any(self.acceleration <= 0)
        ):
            raise ConfigError(
                f"joint limits {self.lower.tolist()}, {self.upper.tolist()}, {self.velocity.tolist()}, "
                f"{self.acceleration.tolist()}; accepted: lower < upper, velocity > 0, acceleration > 0"
            )

    def quantities(self, lower: Array, upper: Array) -> tuple[_Quantity, _Quantity, _Quantity]:
        """Return position, velocity and acceleration with their limits; those of the position are given."""
        v = self.velocity
        a = self.acceleration
        return (
            _Quantity("position", "rad", lower, upper, _POSITION_SLACK),
            _Quantity("velocity", "rad/s", -v, v),
            _Quantity("acceleration", "rad/s^2", -a, a, _ACCELERATION_SLACK * a),
        )

    def outside(self, position: Array) -> Array:
        """Return how far positions, rad, shape (..., j), lie beyond the limits; 0 within."""
        return np.maximum(np.maximum(self.lower - position, position - self.upper), 0.0)

    def check_near(self, points: TrajectoryPoints, held: Array) -> None:
        """Check that the first point lies at the set-point that is held, shape (3, j).

        Raises:
            TrajectoryError: naming the joint that is furthest away.
        """
        gap = points.position[0] - held[0]
        joint = int(np.argmax(np.abs(gap)))
        if abs(gap[joint]) > self.start_tolerance:
            raise TrajectoryError(
                f"point {points.first}: {self.names[joint]} starts at {points.position[0, joint]:.6g} rad, the "
                f"set-point there is {held[0, joint]:.6g} rad; accepted: within {self.start_tolerance:g} rad, or a "
                "first point later than the start"
            )

    def check_start(self, held: Array, velocity: Array, period: float, number: int = 0) -> None:
        """Check that the first velocity, rad/s, shape (j,), follows on the set-point that is `held` there, (3, j).

        `period` is that of the position loop, s, `number` that of the first point.

        Raises:
            TrajectoryError: naming the joint whose velocity would jump, both velocities and the accepted range.
        """
        allowed = self.acceleration * period
        found = _Quantity("", "", held[1] - allowed, held[1] + allowed).first_outside(
            velocity[None]
        )
        if found is not None:
            joint = found[1]
            raise TrajectoryError(
                f"point {number}: {self.names[joint]} starts at {velocity[joint]:.6g} rad/s, the set-point there moves "
                f"at {held[1, joint]:.6g} rad/s; accepted: within {allowed[joint]:.6g} rad/s, or a first point later "
                "than the start"
            )

    def straight_time(self, way: Array) -> float:
        """Return the least time of a straight line from rest to rest, s; `way` is not 0, rad, shape (j,)."""
        ramp = float((np.abs(way) / self.acceleration).max())
        line = float((np.abs(way) / self.velocity).max())
        return 2.0 * math.sqrt(ramp) if ramp > line * line else line + ramp / line

    def too_early(self, point: int, way: Array, given: float, needed: float) -> TrajectoryError:
        """Return the refusal of a point that is farther away, by `way`, rad, shape (j,), than its time allows, s."""
        joint = int(
            np.argmax(
                np.maximum(
                    2.0 * np.sqrt(np.abs(way) / self.acceleration), np.abs(way) / self.velocity
                )
            )
        )
        return TrajectoryError(
            f"point {point}: {self.names[joint]} cannot go {way[joint]:.6g} rad in {given:.6g} s within its limits, "
            f"{self.velocity[joint]:.6g} rad/s and {self.acceleration[joint]:.6g} rad/s^2; accepted: from "
            f"{math.ceil(needed * 1e3) / 1e3:g} s on"
        )

    def check_points(self, points: TrajectoryPoints, allowed: Array) -> None:
        """Check the points themselves: a spline through points within the limits has finite coefficients.

        They may lie beyond the position limits by as much as is `allowed`, rad, shape (j,).

        Raises:
            TrajectoryError: naming point, joint, value and limit of the first one outside.
        """
        tables = (points.position, points.velocity, points.acceleration)
        for quantity, table in zip(
            self.quantities(self.lower - allowed, self.upper + allowed), tables, strict=True
        ):
            if table is not None and (found := quantity.first_outside(table)) is not None:
                row, joint = found
                raise TrajectoryError(
                    f"point {points.first + row}: {self.names[joint]} has the {quantity.what} {table[row, joint]:.6g} "
                    f"{quantity.unit}; accepted: {quantity.accepted(row, joint)}"
                )

    def check_motion(
        self, spline: Spline, period: float, points: TrajectoryPoints, allowed: Array
    ) -> None:
        """Check a motion: its set-points, and the accelerations between them.

        The accelerations hold at every time of an accepted motion, so that it can be travelled at every lower speed,
        too.
        It ends within the position limits, and can therefore be braked to rest at any time before it reaches
        them.

        Args:
            spline: the motion.
            period: of the position loop, s.
            points: that it goes through, to say which one is meant.
            allowed: how far beyond the position limits the first set-point may lie, rad, shape (j,); none may lie
                further beyond than the one before.

        Raises:
            TrajectoryError: naming joint, point, time, amount and limit.
        """
        if not allowed.any() and self._certainly_within(spline):
            return
        last = int(np.ceil(spline.duration / period - 1e-6))
        for first in range(0, last, _CHECKED_AT_ONCE):
            # The blocks share a set-point, so that the step from one to the next is checked, too.
            times = np.asarray(
                np.arange(first, min(first + _CHECKED_AT_ONCE, last) + 1) * period, dtype=np.float64
            )
            setpoints = spline.sample(times)
            reach = np.minimum.accumulate(
                np.vstack([allowed, self.outside(setpoints[:, 0])]), axis=0
            )
            for quantity, values, at, point in self._of_setpoints(
                setpoints, times, points.times, reach[:-1]
            ):
                found = quantity.first_outside(values)
                if found is not None:
                    row, joint = found
                    raise TrajectoryError(
                        f"point {points.first + point[row]}: {self.names[joint]} gets a set-point {quantity.what} "
                        f"{values[row, joint]:.6g} {quantity.unit} on the way there, at {at[row]:.3f} s; accepted: "
                        f"{quantity.accepted(row, joint)}"
                    )
            allowed = reach[-1]
        self._check_between(spline, points)

    def _certainly_within(self, spline: Spline) -> bool:
        """Return whether bounds of the spline, and so its set-points and the steps between them, are within limits."""
        quantities = self.quantities(self.lower, self.upper)
        extremes = np.stack(spline.bounds(), axis=1)
        return all(
            each.first_outside(pair) is None
            for each, pair in zip(quantities, extremes, strict=True)
        )

    def _of_setpoints(
        self, setpoints: Array, times: Array, knots: Array, reach: Array
    ) -> Iterator[tuple[_Quantity, Array, Array, Index]]:
        """Yield quantities of set-points, their values, shape (m, j), the times and the points that they lead to.

        Points closer to each other than two set-points can hide a jump from every sampled derivative, so that the steps
        from one to the next are checked, too.
        """
        q = setpoints[:, 0]
        v = setpoints[:, 1]
        a = setpoints[:, 2]
        step = np.diff(times)[:, None]
        last = knots.size - 1
        point = np.minimum(np.searchsorted(knots, times), last)
        # At a knot the derivatives are already those of the way to the next point.
        after = np.minimum(np.searchsorted(knots, times, side="right"), last)
        position, velocity, acceleration = self.quantities(self.lower - reach, self.upper + reach)
        yield position, q, times, point
        yield velocity, v, times, after
        yield acceleration, a, times, after
        steps = acceleration._replace(what="step of the velocity of")
        yield steps, np.diff(v, axis=0) / step, times[1:], point[1:]
        # With accelerations up to a, the way between velocities v0 and v1 is (v0 + v1) T/2, within a (T/2)^2.
        most = self.acceleration * (step / 2.0) ** 2
        jump = _Quantity("jump of", "rad", -most, most)
        yield jump, np.diff(q, axis=0) - step * (v[1:] + v[:-1]) / 2.0, times[1:], point[1:]

    def _check_between(self, spline: Spline, points: TrajectoryPoints) -> None:
        """Check the largest accelerations of all pieces."""
        c = spline.coefficients
        span = np.diff(spline.times)[:, None]
        # The derivative of the acceleration is 6 c3 + 24 c4 s + 60 c5 s^2; the extremes lie at its roots or the ends.
        half = 12.0 * c[:, 4]
        square = 60.0 * c[:, 5]
        with np.errstate(divide="ignore", invalid="ignore"):
            root = half + np.copysign(np.sqrt(half * half - square * 6.0 * c[:, 3]), half)
            extremes = (-root / square, -6.0 * c[:, 3] / root)
        for at in (np.zeros_like(half), span + np.zeros_like(half), *extremes):
            inside = np.where((at > 0.0) & (at < span), at, np.where(at == span, at, 0.0))
            value = 2.0 * c[:, 2] + inside * (
                6.0 * c[:, 3] + inside * (12.0 * c[:, 4] + inside * 20.0 * c[:, 5])
            )
            beyond = np.argwhere(~(np.abs(value) <= (1.0 + _BETWEEN_SLACK) * self.acceleration))
            if len(beyond):
                row, joint = beyond[0]
                time = spline.times[row] + inside[row, joint]
                most = self.acceleration[joint]
                middle = 0.5 * (spline.times[row] + spline.times[row + 1])
                point = points.first + min(
                    int(np.searchsorted(points.times, middle)), len(points.times) - 1
                )
                raise TrajectoryError(
                    f"point {point}: {self.names[joint]} gets an acceleration of {value[row, joint]:.6g} rad/s^2 on "
                    f"the way there, between two set-points, at {time:.6g} s; accepted: [{-most:.6g}, {most:.6g}]"
                )


def connect(points: TrajectoryPoints, held: Array, limits: JointLimits) -> Spline:
    """Return the spline through the points, begun at the set-point that the arm then has, shape (3, j).

    Raises:
        TrajectoryError: if the first point is elsewhere, or comes too early.
    """
    times = points.times
    position = points.position
    velocity = points.velocity
    acceleration = points.acceleration
    later = times[0] > 0
    if later:
        times = np.append(0.0, times)
        position = np.vstack([held[0], position])
        velocity = None if velocity is None else np.vstack([held[1], velocity])
        acceleration = None if acceleration is None else np.vstack([held[2], acceleration])
    else:
        limits.check_near(points, held)
    if len(times) == 1:
        return resting(position[-1].copy())
    if velocity is None:
        return straight(times, position, held[1], limits, first=points.first - later)
    if points.degrees is not None:
        degrees = points.degrees if later else points.degrees[1:]
        velocity = np.vstack([held[1] if degrees[0] == 1 else velocity[0], velocity[1:]])
        return _by_degrees(
            times, (position, velocity, acceleration), degrees, limits, points.first - later
        )
    if points.smooth:
        return smooth(times, position, velocity)
    return interpolate(times, position, velocity, acceleration)


def check_time(
    points: TrajectoryPoints, held: Array, limits: JointLimits, period: float, allowed: Array
) -> None:
    """Check that the time of a single point that is later than the start allows the way to it.

    The arguments are those of `connect` and `JointLimits.check_motion`, which say what else is wrong.

    Raises:
        TrajectoryError: naming joint, way, time and the time that it needs.
    """

    def suffices(time: float) -> bool:
        later = replace(points, times=np.array([time]))
        try:
            limits.check_motion(connect(later, held, limits), period, later, allowed)
        except TrajectoryError:
            return False
        return True

    given = float(points.times[0])
    if suffices(given):
        return
    low = given
    high = max(2.0 * given, period)
    while not suffices(high):
        low = high
        high = 2.0 * low
        if low > _LONGEST_MOVE:
            return
    while high > _MOVE_PRECISION * low:
        middle = 0.5 * (low + high)
        if suffices(middle):
            high = middle
        else:
            low = middle
    raise limits.too_early(points.first, points.position[0] - held[0], given, high)


def _by_degrees(
    times: Array,
    tables: tuple[Array, Array, Array | None],
    degrees: Index,
    limits: JointLimits,
    first: int,
) -> Spline:
    """Return the spline through points, the ways between which have the given degrees, shape (n - 1,).

    Args:
        times: s, shape (n,).
        tables: positions, velocities and, if any are given, accelerations, shape (n, j) each.
        degrees: 1, 3 or 5.
        limits: whose accelerations the ramps of straight lines have, at both ends from and to the velocities there.
        first: number of the first point, for refusals.
    """
    position, velocity, acceleration = tables
    begins = np.flatnonzero(np.diff(degrees, prepend=0))
    parts = []
    for begin, end in zip(begins, [*begins[1:], len(degrees)], strict=True):
        run = slice(begin, end + 1)
        q = position[run]
        v = velocity[run]
        if degrees[begin] == 1:
            parts.append(straight(times[run], q, v[0], limits, first + int(begin), v[-1]))
        else:
            a = acceleration[run] if acceleration is not None and degrees[begin] == 5 else None
            parts.append(interpolate(times[run], q, v, a))
    knots = np.concatenate([*(part.times[:-1] for part in parts), times[-1:]])
    coefficients = np.concatenate([part.coefficients for part in parts])
    return Spline(knots, coefficients, position[-1].copy(), max(part.blend_error for part in parts))


def straight(
    times: Array,
    position: Array,
    velocity: Array,
    limits: JointLimits,
    first: int = 0,
    end_velocity: Array | float = 0,
) -> Spline:
    """Return straight lines through points, with ramps of the velocity.

    The first and the last point are met at their times; points in between are missed by dv^2/(8 a).

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, j).
        velocity: at the first point, rad/s, shape (j,).
        limits: whose accelerations the ramps have.
        first: number of the first point, for refusals.
        end_velocity: at the last point, rad/s, shape (j,).

    Raises:
        TrajectoryError: naming the first point that comes too early for the ramps.
    """
    span = np.diff(times)
    way = np.diff(position, axis=0)
    speed = way / span[:, None]
    last = len(span) - 1
    final = np.zeros(position.shape[1]) + end_velocity
    if last == 0:
        begin = end = _both_ends(first + 1, span[0], way[0], (velocity, final), limits)
        speed[0] = (way[0] - (velocity + final) * (begin / 2.0)) / (span[0] - begin)
    else:
        begin = _one_end(first + 1, span[0], way[0], velocity, limits)
        speed[0] = (way[0] - velocity * (begin / 2.0)) / (span[0] - begin / 2.0)
        end = _one_end(first + last + 1, span[last], way[last], final, limits)
        speed[last] = (way[last] - final * (end / 2.0)) / (span[last] - end / 2.0)
    change = np.diff(speed, axis=0)
    half = (np.abs(change) / (2.0 * limits.acceleration)).max(axis=1, initial=0.0)
    # The ramps at the two ends of each line leave room for each other.
    ramps = np.append(begin, half) + np.append(half, end)
    short = ramps > span * (1.0 + 1e-12)
    if short.any():
        k = int(np.argmax(short))
        raise TrajectoryError(
            f"point {first + k + 1}: {span[k]:.6g} s after the point before, the ramps of the velocity take "
            f"{ramps[k]:.6g} s; accepted: points further apart in time, or points with velocities"
        )
    # Where each ramp begins and how long it lasts; then what follows it at constant velocity.
    ramp = np.concatenate([[begin], 2.0 * half, [end]])
    start = np.concatenate([[times[0]], times[1:-1] - half, [times[-1] - end]])
    cruise = np.append(start[1:], start[-1] + ramp[-1]) - (start + ramp)
    around = np.vstack([velocity, speed, final])
    before = around[:-1]
    after = around[1:]
    kept = np.column_stack([ramp > 0.0, cruise > 0.0]).ravel()  # those of no duration are left out
    knots = np.column_stack([start, start + ramp]).ravel()[kept]
    bend = np.zeros((2 * len(start), position.shape[1]))
    bend[::2] = (after - before) / np.where(ramp > 0.0, 2.0 * ramp, 1.0)[:, None]
    ways = np.stack(
        [(before + after) * (ramp / 2.0)[:, None], after * cruise[:, None]], axis=1
    ).reshape(-1, bend.shape[1])[kept]
    coefficients = np.zeros((len(knots), 6, bend.shape[1]))
    coefficients[:, 0] = np.cumsum(np.concatenate([position[:1], ways[:-1]]), axis=0)
    coefficients[:, 1] = np.stack([before, after], axis=1).reshape(bend.shape)[kept]
    coefficients[:, 2] = bend[kept]
    blend_error = float((half[:, None] * np.abs(change)).max(initial=0.0)) / 4.0
    return Spline(
        np.append(knots, start[-1] + ramp[-1]), coefficients, position[-1].copy(), blend_error
    )


def _one_end(point: int, span: float, way: Array, velocity: Array, limits: JointLimits) -> float:
    """Return how long the ramp between `velocity` and that of the line is, at one end of a line, s.

    The ramp takes tau, the rest the line's own velocity v: way = (velocity + v) tau/2 + v (span - tau), and
    |v - velocity| <= a tau.
    """
    missing = 2.0 * np.abs(way - velocity * span) / limits.acceleration
    _refuse_early(point, missing > span * span, span, way, limits)
    return float((span - np.sqrt(span * span - missing)).max())


def _both_ends(
    point: int, span: float, way: Array, ends: tuple[Array, Array], limits: JointLimits
) -> float:
    """Return the duration of the ramps at both ends of a single line, s, from and to the velocities there.

    way = (v0 + v) tau/2 + v (span - 2 tau) + (v + v1) tau/2, with |v - v0| <= a tau and |v - v1| <= a tau; each
    is a quadratic inequality in tau.
    """
    a = limits.acceleration
    (v0, v1) = ends
    least = 0.0
    most = span / 2.0
    for sign in (1.0, -1.0):
        for b, c in (((v0 - v1) / 2.0, way - v1 * span), ((v1 - v0) / 2.0, way - v0 * span)):
            middle = (span + sign * b / a) / 2.0
            square = middle * middle - sign * c / a
            _refuse_early(point, square < 0.0, span, way, limits)
            root = np.sqrt(square)
            least = max(least, float((middle - root).max()))
            most = min(most, float((middle + root).min()))
            _refuse_early(
                point, (middle - root > most) | (middle + root < least), span, way, limits
            )
    return least


def _refuse_early(point: int, early: Mask, span: float, way: Array, limits: JointLimits) -> None:
    if early.any():
        joint = int(np.argmax(early))
        raise TrajectoryError(
            f"point {point}: {limits.names[joint]} cannot go {way[joint]:.6g} rad in {span:.6g} s with its ramps of "
            f"{limits.acceleration[joint]:.6g} rad/s^2; accepted: a later point"
        )


def stop(position: Array, velocity: Array, acceleration: Array) -> Spline:
    """Return the motion that brings each joint to rest on its own, with a constant acceleration.

    It ends at q + v |v|/(2 a), which is within the limits wherever `JointLimits.check_motion` has found room to stop.

    Args:
        position: where it begins, rad, shape (j,).
        velocity: at its begin, rad/s, shape (j,).
        acceleration: the most that each joint may be braked with, rad/s^2, shape (j,).
    """
    duration = np.abs(velocity) / acceleration
    rest = position + velocity * duration / 2.0
    times = np.unique(np.append(0.0, duration))
    at = times[:-1, None]
    brake = -np.sign(velocity) * acceleration
    coefficients = np.zeros((len(times) - 1, 6, rest.size))
    moving = at < duration
    coefficients[:, 0] = np.where(moving, position + at * (velocity + at * brake / 2.0), rest)
    coefficients[:, 1] = np.where(moving, velocity + at * brake, 0.0)
    coefficients[:, 2] = np.where(moving, brake / 2.0, 0.0)
    return Spline(times, coefficients, rest)
