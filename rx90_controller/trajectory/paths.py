"""Paths from where the arm is through the points of a trajectory: splines, straight lines with ramps, and stops.

A line from point to point would change its velocity in no time. An arm that is to do so lags, and passes the point by
about v^2/(2 a). Each change of velocity therefore becomes a ramp of constant acceleration, as short as the limits
allow and of the same duration in all joints, so that the motion stays straight: linear segments with parabolic blends
(Craig 2005, section 7.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.spline import Spline, interpolate, resting, smooth


def connect(points: TrajectoryPoints, held: Array, limits: JointLimits) -> Spline:
    """Return the spline through the points, begun at the set-point that the arm then has, shape (3, 6).

    Raises:
        TrajectoryError: if the first point is elsewhere, or comes too early.
    """
    times, position, velocity, acceleration = points.times, points.position, points.velocity, points.acceleration
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
    if velocity is None:
        return straight(times, position, held[1], limits, first=points.first - later)
    if points.degrees is not None:
        degrees = points.degrees if later else points.degrees[1:]
        velocity = np.vstack([held[1] if degrees[0] == 1 else velocity[0], velocity[1:]])
        return _by_degrees(times, (position, velocity, acceleration), degrees, limits, points.first - later)
    if points.smooth:
        return smooth(times, position, velocity)
    return interpolate(times, position, velocity, acceleration)


def _by_degrees(
    times: Array, tables: tuple[Array, Array, Array | None], degrees: NDArray[np.intp], limits: JointLimits, first: int
) -> Spline:
    """Return the spline through points, the ways between which have the given degrees, shape (n - 1,).

    Args:
        times: s, shape (n,).
        tables: positions, velocities and, if any are given, accelerations, shape (n, 6) each.
        degrees: 1, 3 or 5.
        limits: whose accelerations the ramps of straight lines have, at both ends from and to the velocities there.
        first: number of the first point, for refusals.
    """
    position, velocity, acceleration = tables
    begins = np.flatnonzero(np.diff(degrees, prepend=0))
    parts = []
    for begin, end in zip(begins, [*begins[1:], len(degrees)], strict=True):
        run = slice(begin, end + 1)
        q, v = position[run], velocity[run]
        if degrees[begin] == 1:
            parts.append(straight(times[run], q, v[0], limits, first + int(begin), v[-1]))
        else:
            a = acceleration[run] if acceleration is not None and degrees[begin] == 5 else None
            parts.append(interpolate(times[run], q, v, a))
    knots = np.concatenate([*(part.times[:-1] for part in parts), times[-1:]])
    coefficients = np.concatenate([part.coefficients for part in parts])
    return Spline(knots, coefficients, position[-1].copy(), max(part.blend_error for part in parts))


def straight(
    times: Array, position: Array, velocity: Array, limits: JointLimits, first: int = 0, end_velocity: Array | float = 0
) -> Spline:
    """Return straight lines through points, with ramps of the velocity.

    The first and the last point are met at their times; points in between are missed by dv^2/(8 a).

    Args:
        times: s, shape (n,), increasing, n >= 2.
        position: rad, shape (n, 6).
        velocity: at the first point, rad/s, shape (6,).
        limits: whose accelerations the ramps have.
        first: number of the first point, for refusals.
        end_velocity: at the last point, rad/s, shape (6,).

    Raises:
        TrajectoryError: naming the first point that comes too early for the ramps.
    """
    span, way = np.diff(times), np.diff(position, axis=0)
    speed = way / span[:, None]
    last, final = len(span) - 1, np.zeros(6) + end_velocity
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
    around = np.vstack([velocity, speed, final])
    before, after = around[:-1], around[1:]
    kept = np.column_stack([ramp > 0.0, cruise > 0.0]).ravel()  # those of no duration are left out
    knots = np.column_stack([start, start + ramp]).ravel()[kept]
    bend = np.zeros((2 * len(start), 6))
    bend[::2] = (after - before) / np.where(ramp > 0.0, 2.0 * ramp, 1.0)[:, None]
    ways = np.stack([(before + after) * (ramp / 2.0)[:, None], after * cruise[:, None]], axis=1).reshape(-1, 6)[kept]
    coefficients = np.zeros((len(knots), 6, 6))
    coefficients[:, 0] = np.cumsum(np.concatenate([position[:1], ways[:-1]]), axis=0)
    coefficients[:, 1], coefficients[:, 2] = np.stack([before, after], axis=1).reshape(-1, 6)[kept], bend[kept]
    blend_error = float((half[:, None] * np.abs(change)).max(initial=0.0)) / 4.0
    return Spline(np.append(knots, start[-1] + ramp[-1]), coefficients, position[-1].copy(), blend_error)


def _one_end(point: int, span: float, way: Array, velocity: Array, limits: JointLimits) -> float:
    """Return how long the ramp between `velocity` and that of the line is, at one end of a line, s.

    The ramp takes tau, the rest the line's own velocity v: way = (velocity + v) tau/2 + v (span - tau), and
    |v - velocity| <= a tau.
    """
    missing = 2.0 * np.abs(way - velocity * span) / limits.acceleration
    _refuse_early(point, missing > span * span, span, way, limits)
    return float((span - np.sqrt(span * span - missing)).max())


def _both_ends(point: int, span: float, way: Array, ends: tuple[Array, Array], limits: JointLimits) -> float:
    """Return the duration of the ramps at both ends of a single line, s, from and to the velocities there.

    way = (v0 + v) tau/2 + v (span - 2 tau) + (v + v1) tau/2, with |v - v0| <= a tau and |v - v1| <= a tau; each
    is a quadratic inequality in tau.
    """
    a, (v0, v1) = limits.acceleration, ends
    least, most = 0.0, span / 2.0
    for sign in (1.0, -1.0):
        for b, c in (((v0 - v1) / 2.0, way - v1 * span), ((v1 - v0) / 2.0, way - v0 * span)):
            middle = (span + sign * b / a) / 2.0
            square = middle * middle - sign * c / a
            _refuse_early(point, square < 0.0, span, way, limits)
            root = np.sqrt(square)
            least, most = max(least, float((middle - root).max())), min(most, float((middle + root).min()))
            _refuse_early(point, (middle - root > most) | (middle + root < least), span, way, limits)
    return least


def _refuse_early(point: int, early: NDArray[np.bool_], span: float, way: Array, limits: JointLimits) -> None:
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
        position: where it begins, rad, shape (6,).
        velocity: at its begin, rad/s, shape (6,).
        acceleration: the most that each joint may be braked with, rad/s^2, shape (6,).
    """
    duration = np.abs(velocity) / acceleration
    rest = position + velocity * duration / 2.0
    times = np.unique(np.concatenate([[0.0], duration]))
    at = times[:-1, None]
    brake = -np.sign(velocity) * acceleration
    coefficients = np.zeros((len(times) - 1, 6, 6))
    moving = at < duration
    coefficients[:, 0] = np.where(moving, position + at * (velocity + at * brake / 2.0), rest)
    coefficients[:, 1] = np.where(moving, velocity + at * brake, 0.0)
    coefficients[:, 2] = np.where(moving, brake / 2.0, 0.0)
    return Spline(times, coefficients, rest)
