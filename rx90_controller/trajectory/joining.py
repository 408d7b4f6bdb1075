"""Splines put together: from where the arm is to given points, one path after another, joints of two paths."""

from __future__ import annotations

from math import comb

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.ramps import stop, straight
from rx90_controller.trajectory.spline import Spline, interpolate, smooth


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
    if velocity is None:
        return straight(times, position, held[1], limits, first=points.first - later)
    if points.smooth:
        return smooth(times, position, velocity)
    if points.way is None or not later:
        return interpolate(times, position, velocity, acceleration)
    head = interpolate(times[:2], position[:2], velocity[:2], None if acceleration is None else acceleration[:2])
    return Spline(times, np.concatenate([head.coefficients, points.way.coefficients]), position[-1].copy())


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
    miss = max(first.miss, second.miss)
    return Spline(np.concatenate(times), np.concatenate(coefficients), second.final, miss)


def remainder(spline: Spline, at: float) -> Spline:
    """Return what is left of a spline at a time, s, with times from there on."""
    knots = np.concatenate([[at], spline.times[spline.times > at]])
    return Spline(knots - at, _expanded(spline, knots[:-1]), spline.final)


def merged(spline: Spline, other: Spline, joints: Mask) -> Spline:
    """Return a spline with some joints, shape (6,), taken from another one."""
    knots = np.union1d(spline.times, other.times)
    coefficients = np.where(joints, _expanded(other, knots[:-1]), _expanded(spline, knots[:-1]))
    return Spline(knots, coefficients, np.where(joints, other.final, spline.final), spline.miss)


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
