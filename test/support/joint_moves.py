"""Joint moves for the set-point generator, and as messages: six joints alike, at rest at HOME."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import JointLimits, TrajectoryPoints

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS = JointLimits(NAMES, np.full(6, -2.0), np.full(6, 2.0), np.full(6, 3.0), np.full(6, 60.0), 1e-3)
PERIOD = 1e-3
HOME = np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.6])
ZERO = np.zeros(6)


def within_limits(setpoints: Array, acceleration: Array) -> None:
    """See that velocities are those of the positions, and that no step of them is more than the accelerations allow."""
    q, v = setpoints[:, 0], setpoints[:, 1]
    most = acceleration * (1 + 1e-6)
    assert (np.abs(np.diff(v, axis=0)) <= most * PERIOD).all()
    assert (np.abs(np.diff(q, axis=0) - PERIOD * (v[1:] + v[:-1]) / 2.0) <= most * PERIOD**2 / 4.0).all()


def points(
    times: Sequence[float],
    position: Sequence[Array],
    velocity: Sequence[Array] | None = None,
    names: Sequence[str] = NAMES,
    *,
    moving_end: bool = False,
) -> TrajectoryPoints:
    none: list[list[float]] = [[]] * len(times)
    velocities = none if velocity is None else velocity
    return TrajectoryPoints.create(NAMES, names, times, position, velocities, none, partial=True, moving_end=moving_end)


def move(to: float, seconds: float) -> TrajectoryPoints:
    return points([seconds], [HOME + to], [ZERO])


def stamp(seconds: float, epoch: int = 0) -> SimpleNamespace:
    sec, nanosec = divmod(round(float(seconds) * 1e9), 10**9)
    return SimpleNamespace(sec=epoch + sec, nanosec=nanosec)


def trajectory(
    times: Sequence[float],
    positions: Sequence[Any],
    velocities: Sequence[Any] = (),
    accelerations: Sequence[Any] = (),
    *,
    start: float = 0.0,
    names: Sequence[str] = NAMES,
    frame: str = "",
) -> SimpleNamespace:
    """Return a JointTrajectory; one number stands for all joints, and a table, or a row that is None, for none."""
    tables = [[None] * len(times) if not len(table) else table for table in (positions, velocities, accelerations)]
    points = [
        SimpleNamespace(positions=q, velocities=v, accelerations=a, effort=[], time_from_start=stamp(time))
        for time, q, v, a in zip(times, *([_row(row, len(names)) for row in table] for table in tables), strict=True)
    ]
    header = SimpleNamespace(stamp=stamp(start), frame_id=frame)
    return SimpleNamespace(header=header, joint_names=list(names), points=points)


def _row(row: Any, joints: int) -> list[float]:
    return [] if row is None else [float(row)] * joints if np.isscalar(row) else list(row)
