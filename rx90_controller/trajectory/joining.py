"""Splines put together: from where the arm is to given points, one path after another, joints of two paths."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.ramps import stop, straight
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
        check_near(points, held, limits)
    if len(times) == 1:
        return resting(position[-1].copy())
    if velocity is not None and points.degrees is not None:
        degrees = points.degrees if later else points.degrees[1:]
        start = held[1] if degrees[0] == 1 else velocity[0]
        velocity = np.vstack([start, velocity[1:]])
        return _by_degrees(times, (position, velocity, acceleration), degrees, limits, points.first - later)
    if velocity is None:
        return straight(times, position, held[1], limits, first=points.first - later)
    if points.smooth:
        return smooth(times, position, velocity)
    if points.way is None or not later:
        return interpolate(times, position, velocity, acceleration)
    head = interpolate(times[:2], position[:2], velocity[:2], None if acceleration is None else acceleration[:2])
    return Spline(times, np.concatenate([head.coefficients, points.way.coefficients]), position[-1].copy())


def _by_degrees(
    times: Array,
    tables: tuple[Array, Array, Array | None],
    degrees: NDArray[np.intp],
    limits: JointLimits,
    first: int,
) -> Spline:
    """Return the spline through points, the ways between which have the given degrees, shape (n - 1,).

    Args:
        times: s, shape (n,).
        tables: positions, velocities and, if any are given, accelerations, shape (n, 6) each.
        degrees: 1, 3 or 5.
        limits: whose accelerations the ramps of straight lines have, at both ends from and to the velocities there.
        first: number of the first point, for refusals.
    """
    begins = np.flatnonzero(np.diff(degrees, prepend=0))
    parts = []
    for begin, end in zip(begins, [*begins[1:], len(degrees)], strict=True):
        run = slice(begin, end + 1)
        q, v, a = (None if table is None else table[run] for table in tables)
        assert q is not None
        assert v is not None
        if degrees[begin] == 1:
            parts.append(straight(times[run], q, v[0], limits, first + int(begin), v[-1]))
        else:
            parts.append(interpolate(times[run], q, v, a if degrees[begin] == 5 else None))
    knots = np.concatenate([*(part.times[:-1] for part in parts), times[-1:]])
    coefficients = np.concatenate([part.coefficients for part in parts])
    return Spline(knots, coefficients, tables[0][-1].copy(), max(part.blend_error for part in parts))


def check_near(points: TrajectoryPoints, held: Array, limits: JointLimits) -> None:
    """Check that the first point lies at the set-point that is held, shape (3, 6).

    Raises:
        TrajectoryError: naming the joint that is furthest away.
    """
    gap = points.position[0] - held[0]
    joint = int(np.argmax(np.abs(gap)))
    if abs(gap[joint]) > limits.start_tolerance:
        raise TrajectoryError(
            f"point {points.first}: {limits.names[joint]} starts at {points.position[0, joint]:.6g} rad, the "
            f"set-point there is {held[0, joint]:.6g} rad; accepted: within "
            f"{limits.start_tolerance:g} rad, or a first point later than the start"
        )


def braked(spline: Spline, velocity: Array, limits: JointLimits) -> Spline:
    """Return a spline behind whose end, where it has a velocity, rad/s, shape (6,), each joint brakes to rest."""
    return joined(spline, spline.duration, stop(spline.final, velocity, limits.acceleration))


def joined(first: Spline, at: float, second: Spline) -> Spline:
    """Return a spline that is the first one up to a time, s, and then the second one from its begin on."""
    kept = first.times[:-1] < at
    times, coefficients = [first.times[:-1][kept]], [first.coefficients[kept]]
    if at > first.duration:
        times.append(first.times[-1:])
        coefficients.append(_constant(first.final))
    times.append(at + second.times)
    coefficients.append(second.coefficients)
    blend_error = max(first.blend_error, second.blend_error)
    return Spline(np.concatenate(times), np.concatenate(coefficients), second.final, blend_error)


def remainder(spline: Spline, at: float) -> Spline:
    """Return what is left of a spline at a time, s, with times from there on."""
    knots = np.concatenate([[at], spline.times[spline.times > at]])
    return Spline(knots - at, _expanded(spline, knots[:-1]), spline.final)


def merged(spline: Spline, other: Spline, joints: Mask) -> Spline:
    """Return a spline with some joints, shape (6,), taken from another one."""
    knots = np.union1d(spline.times, other.times)
    coefficients = np.where(joints, _expanded(other, knots[:-1]), _expanded(spline, knots[:-1]))
    return Spline(knots, coefficients, np.where(joints, other.final, spline.final), spline.blend_error)


def _expanded(spline: Spline, knots: Array) -> Array:
    """Return the coefficients of a spline by the times since other knots that include its own, shape (n, 6, 6)."""
    piece = np.maximum(np.searchsorted(spline.times, knots, side="right") - 1, 0)
    ended = knots >= spline.duration
    coefficients = np.zeros((len(knots), 6, 6))
    coefficients[ended, 0] = spline.final
    old = spline.coefficients[piece[~ended]]
    since = (knots[~ended] - spline.times[piece[~ended]])[:, None]
    for power in range(6):
        # Taylor's formula, by Horner's scheme.
        value = np.zeros((len(old), 6))
        for n in range(5, power - 1, -1):
            value = value * since + comb(n, power) * old[:, n]
        coefficients[~ended, power] = value
    return coefficients


def _constant(position: Array) -> Array:
    coefficients = np.zeros((1, 6, 6))
    coefficients[0, 0] = position
    return coefficients
