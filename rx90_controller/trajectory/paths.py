"""The limits of set-points, and paths within them through the points of a trajectory: splines, lines, stops.

A straight line from point to point would need jumps of the velocity. An arm would lag behind them, and pass the point
by about v^2/(2 a). Each change of velocity therefore becomes a ramp of constant acceleration, as short as the limits
allow and of the same duration in all joints, so that the motion stays straight: linear segments with parabolic blends
(Craig 2005, section 7.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
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

    def _quantities(self, lower: Array, upper: Array) -> tuple[_Quantity, _Quantity, _Quantity]:
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
        return np.asarray(np.maximum(np.maximum(self.lower - position, position - self.upper), 0.0))

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
            self._quantities(self.lower - allowed, self.upper + allowed), tables, strict=True
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
        """Check a motion: positions and velocities of its set-points, and accelerations at every time.

        It can therefore be travelled at every lower speed, too; and as it ends within the position limits, it can be
        braked to rest at any time before it reaches them.

        Args:
            spline: the motion.
            period: of the position loop, s.
            points: that it goes through, to say which one is meant.
            allowed: how far beyond the position limits the first set-point may lie, rad, shape (j,); none may lie
                further beyond than the one before.

        Raises:
            TrajectoryError: naming joint, point, time, amount and limit.
        """
        position, velocity, acceleration = quantities = self._quantities(self.lower, self.upper)
        bounds = zip(quantities, spline.control_points(), strict=True)
        if not allowed.any() and all(item.first_outside(rows) is None for item, rows in bounds):
            return
        times, values = _extreme_accelerations(spline)
        acceleration = acceleration._replace(slack=_BETWEEN_SLACK * self.acceleration)
        self._check_on_the_way(acceleration, values, times, points)
        last = int(np.ceil(spline.duration / period - 1e-6)) + 1
        for first in range(0, last, _CHECKED_AT_ONCE):
            ticks = np.arange(first, min(first + _CHECKED_AT_ONCE, last), dtype=np.float64)
            times = ticks * period
            setpoints = spline.sample(times)
            beyond = np.vstack([allowed, self.outside(setpoints[:, 0])])
            reach = np.minimum.accumulate(beyond, axis=0)
            allowed = reach[-1]
            position = position._replace(low=self.lower - reach[:-1], high=self.upper + reach[:-1])
            self._check_on_the_way(position, setpoints[:, 0], times[:, None], points)
            self._check_on_the_way(velocity, setpoints[:, 1], times[:, None], points)

    def _check_on_the_way(
        self, quantity: _Quantity, values: Array, times: Array, points: TrajectoryPoints
    ) -> None:
        """Check values of the joints, shape (m, j), at times, s, that broadcast to that shape."""
        found = quantity.first_outside(values)
        if found is None:
            return
        row, joint = found
        time = float(np.broadcast_to(times, values.shape)[row, joint])
        point = min(int(np.searchsorted(points.times, time)), len(points.times) - 1)
        raise TrajectoryError(
            f"point {points.first + point}: {self.names[joint]} gets the {quantity.what} {values[row, joint]:.6g} "
            f"{quantity.unit} on the way there, at {time:.6g} s; accepted: {quantity.accepted(row, joint)}"
        )


def _extreme_accelerations(spline: Spline) -> tuple[Array, Array]:
    """Return times, s, and accelerations, shape (m, j) each, among which are the extremes of all pieces."""
    c = spline.coefficients
    span = np.diff(spline.times)[:, None]
    # The derivative of the acceleration is 6 c3 + 24 c4 s + 60 c5 s^2; the extremes lie at its roots or the ends.
    half = 12.0 * c[:, 4]
    square = 60.0 * c[:, 5]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        root = half + np.copysign(np.sqrt(half * half - square * 6.0 * c[:, 3]), half)
        places = np.stack([0.0 * half, span + 0.0 * half, -root / square, -6.0 * c[:, 3] / root])
    # At the begin of a piece, but in it: that way is meant, and not the one before.
    since = np.clip(np.nan_to_num(places), 1e-9 * span, span)
    values = 2.0 * c[:, 2] + since * (
        6.0 * c[:, 3] + since * (12.0 * c[:, 4] + since * 20.0 * c[:, 5])
    )
    times = spline.times[:-1, None] + since
    return times.reshape(-1, c.shape[2]), values.reshape(-1, c.shape[2])


def connect(
    points: TrajectoryPoints, held: Array, limits: JointLimits, *, smoothly: bool = False
) -> Spline:
    """Return the spline through the points, begun at the set-point that the arm then has, shape (3, j).

    A first point at the start itself is passed as it is, or `smoothly`, from that set-point on.

    Raises:
        TrajectoryError: if the first point is elsewhere, or comes too early.
    """
    times = points.times
    position = points.position
    velocity = points.velocity
    acceleration = points.acceleration
    later = times[0] > 0
    if later:
        times = np.concatenate([[0.0], times])
        position = np.vstack([held[0], position])
        velocity = None if velocity is None else np.vstack([held[1], velocity])
        acceleration = None if acceleration is None else np.vstack([held[2], acceleration])
    else:
        limits.check_near(points, held)
    if len(times) == 1:
        return resting(position[-1].copy())
    if smoothly:
        position = np.vstack([held[0], position[1:]])
    if velocity is None:
        return straight(times, position, held[1], limits, first=points.first - later)
    if points.smooth:
        return smooth(times, position, velocity)
    return interpolate(times, position, velocity, acceleration)


def straight(
    times: Array,
    position: Array,
    velocity: Array,
    limits: JointLimits,
    first: int = 0,
) -> Spline:
    """Return straight lines through points, with ramps of the velocity.

    The first and the last point are met at their times; points in between are missed by dv^2/(8 a).

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, j).
        velocity: at the first point, rad/s, shape (j,).
        limits: whose accelerations the ramps have.
        first: number of the first point, for refusals.

    Raises:
        TrajectoryError: naming the first point that comes too early for the ramps.
    """
    span = np.diff(times)
    way = np.diff(position, axis=0)
    speed = way / span[:, None]
    last = len(span) - 1
    rest = np.zeros(position.shape[1])
    if last == 0:
        begin = end = _both_ends(first + 1, span[0], way[0], velocity, limits)
        speed[0] = (way[0] - velocity * (begin / 2.0)) / (span[0] - begin)
    else:
        begin = _one_end(first + 1, span[0], way[0], velocity, limits)
        speed[0] = (way[0] - velocity * (begin / 2.0)) / (span[0] - begin / 2.0)
        end = _one_end(first + last + 1, span[last], way[last], rest, limits)
        speed[last] = way[last] / (span[last] - end / 2.0)
    change = np.diff(speed, axis=0)
    half = (np.abs(change) / (2.0 * limits.acceleration)).max(axis=1, initial=0.0)
    # The ramps at the two ends of each line leave room for each other.
    ramps = np.concatenate([[begin], half]) + np.concatenate([half, [end]])
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
    around = np.vstack([velocity, speed, rest])
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
    return Spline(np.append(knots, start[-1] + ramp[-1]), coefficients, position[-1].copy())


def _one_end(point: int, span: float, way: Array, velocity: Array, limits: JointLimits) -> float:
    """Return how long the ramp between `velocity` and that of the line is, at one end of a line, s.

    The ramp takes tau, the rest the line's own velocity v: way = (velocity + v) tau/2 + v (span - tau), and
    |v - velocity| <= a tau.
    """
    missing = 2.0 * np.abs(way - velocity * span) / limits.acceleration
    _refuse_early(point, missing > span * span, span, way, limits)
    return float((span - np.sqrt(span * span - missing)).max())


def _both_ends(point: int, span: float, way: Array, velocity: Array, limits: JointLimits) -> float:
    """Return the duration of the ramps at both ends of a single line, s, from a velocity and to rest.

    way = (v0 + v) tau/2 + v (span - 2 tau) + v tau/2, with |v - v0| <= a tau and |v| <= a tau; each is a quadratic
    inequality in tau.
    """
    a = limits.acceleration
    least = 0.0
    most = span / 2.0
    for sign in (1.0, -1.0):
        for b, c in ((velocity / 2.0, way), (-velocity / 2.0, way - velocity * span)):
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


def _refuse_early(
    point: int, early: NDArray[np.bool_], span: float, way: Array, limits: JointLimits
) -> None:
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
    times = np.unique(np.concatenate([[0.0], duration]))
    at = times[:-1, None]
    brake = -np.sign(velocity) * acceleration
    coefficients = np.zeros((len(times) - 1, 6, rest.size))
    moving = at < duration
    coefficients[:, 0] = np.where(moving, position + at * (velocity + at * brake / 2.0), rest)
    coefficients[:, 1] = np.where(moving, velocity + at * brake, 0.0)
    coefficients[:, 2] = np.where(moving, brake / 2.0, 0.0)
    return Spline(times, coefficients, rest)
