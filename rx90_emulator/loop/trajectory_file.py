"""Trajectories in files: the YAML of a JointTrajectory, as `rx90_line --output` and `ros2 topic echo` write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rx90_common.bags.topics import POINT_FIELDS
from rx90_common.base.config import load_yaml
from rx90_common.base.errors import ConfigError, TrajectoryError
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.message import points_from_message

_ACCEPTED = "the YAML of a trajectory_msgs/JointTrajectory"


def load_trajectory(name: Path | str, robot_joints: Sequence[str]) -> TrajectoryPoints:
    """Read the points of a trajectory, joints in any order.

    The header is not looked at: when the trajectory starts is for the run to say.

    Raises:
        ConfigError: naming file and reason, for a file that cannot be read or is no trajectory.
        TrajectoryError: naming file, joint, index of the point and reason.
    """
    file = Path(name)
    # `ros2 topic echo` ends each message with a line of dashes.
    data = load_yaml(file, _ACCEPTED, first=True).content
    try:
        return points_from_message(robot_joints, _message(data))
    except TrajectoryError as error:
        raise TrajectoryError(f"{file}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{file}: {error!r}; accepted: {_ACCEPTED}") from error


def _message(data: dict[str, Any]) -> SimpleNamespace:
    points = [
        SimpleNamespace(
            time_from_start=SimpleNamespace(
                sec=int(point["time_from_start"].get("sec", 0)), nanosec=int(point["time_from_start"].get("nanosec", 0))
            ),
            **{name: [float(value) for value in point.get(name) or []] for name in POINT_FIELDS},
        )
        for point in data["points"]
    ]
    return SimpleNamespace(joint_names=[str(name) for name in data["joint_names"]], points=points)
