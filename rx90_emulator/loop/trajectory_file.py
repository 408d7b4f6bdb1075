"""Write the set-points of a motion: as the YAML of a JointTrajectory, or as a table for other programs."""

from __future__ import annotations

import math
from io import StringIO
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.description.kinematics import forward
from rx90_common.description.robot import RobotModel
from rx90_common.process.files import write_text
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction, PlayedCorrection
from rx90_controller.trajectory.points import message_content
from rx90_controller.trajectory.spline import interpolate

_MILLI = 1e3
_POSE = (
    "tool x [mm]",
    "tool y [mm]",
    "tool z [mm]",
    "tool roll [deg]",
    "tool pitch [deg]",
    "tool yaw [deg]",
)


def write_trajectory(
    file: Path,
    robot: RobotModel,
    points: TrajectoryPoints,
    period: float,
    correction: Correction | None = None,
) -> None:
    """Write a motion to a file, whose suffix says how.

    Args:
        file: `.csv` for a table of set-points: time, joints in degrees, place of the tool centre point in mm and roll,
            pitch and yaw about fixed axes in degrees; any other for the YAML of a trajectory_msgs/JointTrajectory.
        robot: the arm.
        points: with velocities and accelerations.
        period: of the set-points in a table, s.
        correction: of the motion; it is in the table, faded in and out as it is played, and not in the YAML, which has
            no channel for it.
    """
    if file.suffix.lower() != ".csv":
        write_text(file, yaml_text(message_content(robot.joint_names, points)))
        return
    from scipy.spatial.transform import Rotation  # takes a while

    assert points.velocity is not None
    curve = interpolate(points.times, points.position, points.velocity, points.acceleration)
    end = float(points.times[-1])
    count = int(np.floor(end / period + 1e-6)) + 1
    played = None
    if correction is not None:
        played = PlayedCorrection.started(correction, 0)
        count = max(count, math.ceil(played.over * correction.period / period - 1e-6) + 1)
    time: Array = np.asarray(np.arange(count) * period, dtype=np.float64)
    angles = curve.sample(np.minimum(time, end))[:, 0]
    if played is not None:
        ticks = np.rint(time / played.correction.period).astype(np.int64)
        angles = angles + played.at(ticks)
    pose = forward(robot.chain, angles)
    turn = np.unwrap(Rotation.from_matrix(pose.rotation).as_euler("xyz"), axis=0)
    columns = np.column_stack([time, np.degrees(angles), _MILLI * pose.position, np.degrees(turn)])
    table = StringIO()
    head = ["time [s]", *(f"{name} [deg]" for name in robot.joint_names), *_POSE]
    np.savetxt(table, columns, fmt="%.6f", delimiter=",", header=",".join(head), comments="")
    write_text(file, table.getvalue())
