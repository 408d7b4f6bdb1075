"""Whether a spline keeps to the limits: by bounds where they tell, else set-point by set-point."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.spline import Bounds, Spline

_BLOCK = 4096
# The largest acceleration lies between two set-points, and may be a little more than the largest set-point.
_SLACK = 1e-3  # of the limit


def check_spline(spline: Spline, period: float, points: TrajectoryPoints, limits: JointLimits, allowed: Array) -> None:
    """Check a motion: its set-points, and the accelerations between them.

    What passes is within the accelerations wherever it is, so that it can be travelled at every lower speed too.

    Args:
        spline: the motion.
        period: of the position loop, s.
        points: that it goes through, to say which one is meant.
        limits: to keep.
        allowed: how far beyond the position limits the first set-point may lie, rad, shape (6,).

    Raises:
        TrajectoryError: naming joint, point, time, amount and limit.
    """
    if not allowed.any() and _surely_within(spline, points, limits):
        return
    last = int(np.ceil(spline.duration / period - 1e-6))
    for first in range(0, last, _BLOCK):
        # The blocks share a set-point, so that the step from one to the next is checked, too.
        ticks = np.arange(first, min(first + _BLOCK, last) + 1)
        times = np.asarray(ticks * period, dtype=np.float64)
        allowed = limits.check(spline.sample(times), times, points.times, allowed, points.first)
    _check_between(spline, points, limits)


def _surely_within(spline: Spline, points: TrajectoryPoints, limits: JointLimits) -> bool:
    """Return whether bounds tell that a spline is within the limits.

    With a whole spline within the accelerations, its set-points are too, and the steps between them.
    """
    coefficients, span, bounds = spline.coefficients, np.diff(spline.times), []
    if points.way is not None and len(span) == len(points.way.coefficients) + 1:
        # Left is what leads to the first point.
        coefficients, span, bounds = coefficients[:1], span[:1], [points.way.bounds]
    bounds.append(Bounds.of(coefficients, span))
    return all(limits.contain(*each) for each in bounds)


def _check_between(spline: Spline, points: TrajectoryPoints, limits: JointLimits) -> None:
    """Check the largest accelerations of all pieces."""
    c, span = spline.coefficients, np.diff(spline.times)[:, None]
    # The derivative of the acceleration is 6 c3 + 24 c4 s + 60 c5 s^2; the extremes lie at its roots or at the ends.
    half, square = 12.0 * c[:, 4], 60.0 * c[:, 5]
    with np.errstate(divide="ignore", invalid="ignore"):
        root = half + np.copysign(np.sqrt(half * half - square * 6.0 * c[:, 3]), half)
        extremes = (-root / square, -6.0 * c[:, 3] / root)
    for at in (np.zeros_like(half), span + np.zeros_like(half), *extremes):
        inside = np.where((at > 0.0) & (at < span), at, np.where(at == span, at, 0.0))
        value = 2.0 * c[:, 2] + inside * (6.0 * c[:, 3] + inside * (12.0 * c[:, 4] + inside * 20.0 * c[:, 5]))
        beyond = np.argwhere(~(np.abs(value) <= (1.0 + _SLACK) * limits.acceleration))
        if len(beyond):
            row, joint = beyond[0]
            time, most = spline.times[row] + inside[row, joint], limits.acceleration[joint]
            middle = 0.5 * (spline.times[row] + spline.times[row + 1])
            point = points.first + min(int(np.searchsorted(points.times, middle)), len(points.times) - 1)
            raise TrajectoryError(
                f"point {point}: {limits.names[joint]} gets an acceleration of {value[row, joint]:.6g} rad/s^2 on the "
                f"way there, between two set-points, at {time:.6g} s; accepted: [{-most:.6g}, {most:.6g}]"
            )
