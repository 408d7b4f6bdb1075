"""Motions with constant accelerations: straight lines between points given by position alone, and stops.

A line from point to point would change its velocity in no time. An arm that is told to do so lags, and passes the point
by about v^2/(2 a). Each change of velocity therefore becomes a ramp of constant acceleration, as short as the limits
allow and of the same duration in all joints, so that the motion stays straight: linear segments with parabolic blends
(Craig 2005, section 7.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.spline import Spline


def straight(
    times: Array,
    position: Array,
    velocity: Array,
    limits: JointLimits,
    first: int = 0,
    end_velocity: Array | float = 0.0,
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
    _check_room(span, np.concatenate([[begin], half]), np.concatenate([half, [end]]), first)
    # Where each ramp begins and how long it lasts.
    ramp = np.concatenate([[begin], 2.0 * half, [end]])
    start = np.concatenate([[times[0]], times[1:-1] - half, [times[-1] - end]])
    around = np.vstack([velocity, speed, final])
    blend_error = float((half[:, None] * np.abs(change)).max(initial=0.0)) / 4.0
    return _pieces(start, ramp, around, position[0], position[-1].copy(), blend_error)


def stop(position: Array, velocity: Array, acceleration: Array) -> Spline:
    """Return the motion that brings each joint to rest on its own, with a constant acceleration.

    It ends at q + v |v|/(2 a), which is within the limits wherever `JointLimits.check` has found room to stop.

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


def _check_room(span: Array, before: Array, after: Array, first: int) -> None:
    """Check that the ramps at the two ends of each line leave room for each other."""
    short = before + after > span * (1.0 + 1e-12)
    if short.any():
        k = int(np.argmax(short))
        raise TrajectoryError(
            f"point {first + k + 1}: {span[k]:.6g} s after the point before, the ramps of the velocity take "
            f"{before[k] + after[k]:.6g} s; accepted: points further apart in time, or points with velocities"
        )


def _pieces(start: Array, ramp: Array, around: Array, first: Array, final: Array, blend_error: float) -> Spline:
    """Return the spline of the ramps that begin at `start`, with constant velocity between them.

    Args:
        start: of the ramps, s, shape (m,).
        ramp: their durations, s, shape (m,); those of no duration are left out.
        around: velocities before, between and after them, rad/s, shape (m + 1, 6).
        first: position at the begin, rad, shape (6,).
        final: position at the end, rad, shape (6,).
        blend_error: by how much points are missed, rad.
    """
    stops = np.append(start[1:], start[-1] + ramp[-1])
    before, after = around[:-1], around[1:]
    cruise = stops - (start + ramp)
    # Each ramp, then what follows it at constant velocity; those of no duration are left out.
    kept = np.column_stack([ramp > 0.0, cruise > 0.0]).ravel()
    times = np.column_stack([start, start + ramp]).ravel()[kept]
    velocity = np.stack([before, after], axis=1).reshape(-1, 6)[kept]
    bend = np.zeros((2 * len(start), 6))
    bend[::2] = (after - before) / np.where(ramp > 0.0, 2.0 * ramp, 1.0)[:, None]
    ways = np.stack([(before + after) * (ramp / 2.0)[:, None], after * cruise[:, None]], axis=1).reshape(-1, 6)[kept]
    coefficients = np.zeros((len(times), 6, 6))
    coefficients[:, 0] = np.cumsum(np.concatenate([first[None], ways[:-1]]), axis=0)
    coefficients[:, 1], coefficients[:, 2] = velocity, bend[kept]
    return Spline(np.append(times, stops[-1]), coefficients, final, blend_error)
