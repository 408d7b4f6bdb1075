"""Joint moves for the set-point generator: six joints alike, at rest at HOME."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import JointLimits, TrajectoryPoints

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = JointLimits(NAMES, np.full(6, -2.0), np.full(6, 2.0), np.full(6, 3.0), np.full(6, 60.0), 1e-3)
PERIOD = 1e-3
HOME = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.6])
ZERO = np.zeros(6)


def points(
    times: Sequence[float], position: Sequence[Array], velocity: Sequence[Array] | None = None
) -> TrajectoryPoints:
    """Return checked points in the robot's joint order."""
    return TrajectoryPoints.create(NAMES, NAMES, times, position, velocity or [[]] * len(times), [[]] * len(times))


def move(to: float, seconds: float) -> TrajectoryPoints:
    """Return a smooth motion from wherever the arm is by `to` rad in every joint."""
    return points([seconds], [HOME + to], [ZERO])
