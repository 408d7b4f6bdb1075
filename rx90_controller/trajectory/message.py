"""From trajectory_msgs/JointTrajectory to checked points and a start tick, and back; needs no rclpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rx90_common.bags.topics import POINT_FIELDS
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.cdr import CdrReader
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.points import check_joints

_LEAST_POINT = 4 * len(POINT_FIELDS) + 8  # bytes: four empty sequences and a time


def check_trajectory_bytes(raw: bytes) -> None:
    """Look whether the CDR bytes of a JointTrajectory are whole.

    Raises:
        ExchangeError: naming the field in which they are not.
    """
    reader = CdrReader(raw)
    reader.stamp_ns()
    reader.string("header.frame_id")
    for i in range(reader.count("joint_names", least_bytes=4)):
        reader.string(f"joint_names[{i}]")
    for i in range(reader.count("points", least_bytes=_LEAST_POINT)):
        for name in POINT_FIELDS:
            reader.doubles(f"points[{i}].{name}")
        reader.duration(f"points[{i}].time_from_start")


def points_from_message(
    robot_joints: Sequence[str], message: Any, *, partial: bool = False, moving_end: bool = False, smooth: bool = False
) -> TrajectoryPoints:
    """Return the points of a JointTrajectory in the robot's joint order.

    `partial` and `moving_end` are those of `TrajectoryPoints.create`; with `smooth` they are `smoothed`.

    Raises:
        TrajectoryError: naming joint, index of the point and reason.
    """
    for i, point in enumerate(message.points):
        if len(point.effort) > 0:
            raise TrajectoryError(f"point {i}: carries effort; accepted: positions, velocities, accelerations")
    points = TrajectoryPoints.create(
        robot_joints,
        list(message.joint_names),
        [_seconds(point.time_from_start) for point in message.points],
        [point.positions for point in message.points],
        [point.velocities for point in message.points],
        [point.accelerations for point in message.points],
        partial=partial,
        moving_end=moving_end,
    )
    return points.smoothed() if smooth else points


def check_joint_names(robot_joints: Sequence[str], message: Any, *, partial: bool = False) -> None:
    """Check that a JointTrajectory names the robot's joints, each once, in any order; all of them unless `partial`.

    Raises:
        TrajectoryError: naming the joint that does not fit.
    """
    check_joints(robot_joints, list(message.joint_names), partial=partial)


def start_tick(message: Any, position_hz: int) -> int | None:
    """Return the position tick of `header.stamp`, the first one not before it; None if the stamp is 0, "now"."""
    nanoseconds = message_time_ns(message.header.stamp)
    if nanoseconds == 0:
        return None
    return int(-(-nanoseconds * position_hz // NANOSECONDS))


def check_horizon(start: int | None, now: int, horizon: float, period: float) -> None:
    """Check that a start tick, None for now, is not further ahead than a horizon, s; the period is in s.

    Raises:
        TrajectoryError: naming the start, the present time and what is accepted.
    """
    if start is not None and (start - now) * period > horizon:
        raise TrajectoryError(
            f"start time {start * period:.3f} s, the controller's time is {now * period:.3f} s; accepted: 0 for now, "
            f"or simulated time within {horizon:g} s"
        )


def _seconds(duration: Any) -> float:
    # One division: the nearest number to the whole nanoseconds, as the planner has it.
    return message_time_ns(duration) / NANOSECONDS


class StampedPoint(NamedTuple):
    """One point of a message: time from its start, whole seconds and nanoseconds, and six joints in SI.

    What the points of the trajectory do not carry is empty.
    """

    sec: int
    nanosec: int
    position: list[float]
    velocity: list[float]
    acceleration: list[float]


def stamped_points(points: TrajectoryPoints) -> list[StampedPoint]:
    """Return the points as a message has them."""
    count, degrees = len(points.times), points.degrees
    columns = [
        [[]] * count if values is None else values.tolist()
        for values in (points.position, points.velocity, points.acceleration)
    ]
    if degrees is not None:
        # Of what a point carries counts what a way on one of its sides has.
        around = np.maximum(degrees, np.append(degrees[1:], 1))
        columns[1:] = [
            [row if degree >= least else [] for row, degree in zip(rows, around, strict=True)]
            for rows, least in zip(columns[1:], (3, 5), strict=True)
        ]
    times = [divmod(round(float(time) * NANOSECONDS), NANOSECONDS) for time in points.times]
    return [StampedPoint(*time, *row) for time, *row in zip(times, *columns, strict=True)]


def message_content(joint_names: Sequence[str], points: TrajectoryPoints) -> dict[str, Any]:
    """Return the points as the content of a trajectory_msgs/JointTrajectory, as `ros2 topic pub` takes it in YAML."""
    return {
        "joint_names": list(joint_names),
        "points": [
            {
                "positions": point.position,
                "velocities": point.velocity,
                "accelerations": point.acceleration,
                "time_from_start": {"sec": point.sec, "nanosec": point.nanosec},
            }
            for point in stamped_points(points)
        ],
    }
