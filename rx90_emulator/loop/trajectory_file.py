"""Trajectories in files: the YAML of a JointTrajectory, as `rx90_line --output` and `ros2 topic echo` write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Integer, ListOf, Number, Texts
from rx90_common.base.errors import ConfigError, TrajectoryError
from rx90_common.base.groups import Group
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.points import points_from_message

_ACCEPTED = "the YAML of a trajectory_msgs/JointTrajectory"
_TIME = {
    "sec": Integer("Whole seconds.", "s", low=-(2**31), high=2**31 - 1, default=0),
    "nanosec": Integer("The rest.", "ns", low=0, high=2**32 - 1, default=0),
}
_OF_JOINTS = {
    name: ListOf(about, unit, item=Number(""), accepted="a list of numbers", default=())
    for name, about, unit in (
        ("positions", "Of each joint.", "rad"),
        ("velocities", "Of each joint; may be left out.", "rad/s"),
        ("accelerations", "Of each joint, with velocities; may be left out.", "rad/s^2"),
        ("effort", "None: the controller follows positions.", "Nm"),
    )
}
TRAJECTORY = Group(
    "A trajectory_msgs/JointTrajectory; the header is not looked at.",
    keys={
        "joint_names": Texts("The robot's joints, in any order."),
        "points": ListOf(
            "Points in the order of their times.",
            item=Group(
                "A point.",
                keys={
                    **_OF_JOINTS,
                    "time_from_start": Group("Its time.", keys=_TIME, known=False),
                },
                known=False,
            ),
            accepted="a list of points",
        ),
    },
    known=False,
)
"""What a trajectory file holds."""


def load_trajectory(name: Path | str, robot_joints: Sequence[str]) -> TrajectoryPoints:
    """Read the points of a trajectory, joints in any order.

    The header is not looked at: when the trajectory starts is for the run to say.

    Raises:
        ConfigError: naming file and reason, for a file that cannot be read or is no trajectory.
        TrajectoryError: naming file, joint, index of the point and reason.
    """
    file = Path(name)
    # `ros2 topic echo` ends each message with a line of dashes.
    root = load_yaml(file, _ACCEPTED, first=True)
    try:
        content = TRAJECTORY.read(root)
    except ConfigError as error:
        raise ConfigError(f"{error}, as {_ACCEPTED} has") from error
    points = [
        SimpleNamespace(
            time_from_start=SimpleNamespace(**{key: point["time_from_start"][key] for key in _TIME}),
            **{name: list(point[name] or ()) for name in _OF_JOINTS},
        )
        for point in content["points"]
    ]
    try:
        return points_from_message(
            robot_joints, SimpleNamespace(joint_names=list(content["joint_names"]), points=points)
        )
    except TrajectoryError as error:
        raise TrajectoryError(f"{file}: {error}") from error
