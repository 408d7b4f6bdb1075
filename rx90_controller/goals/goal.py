"""A goal of FollowJointTrajectory, checked: control_msgs/action/FollowJointTrajectory, needs no rclpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rx90_controller.goals.tolerances import Tolerances
from rx90_controller.trajectory import TrajectoryPoints


@dataclass(frozen=True)
class GoalOptions:
    """What else is accepted; names and defaults as the parameters of joint_trajectory_controller.

    Attributes:
        allow_partial_joints_goal: a goal may name some of the joints; the others hold their set-point, and brake to
            rest before if they move (with `allow_trajectory_replacement` they go on along their trajectory).
        allow_nonzero_velocity_at_trajectory_end: the last point may have a velocity; unless another trajectory follows,
            each joint brakes behind it.
        allow_trajectory_replacement: the first point may lie elsewhere than the set-point at the start: points that are
            not later than the start are left out, and the motion goes to the next one from where the path is then.
    """

    allow_partial_joints_goal: bool = False
    allow_nonzero_velocity_at_trajectory_end: bool = False
    allow_trajectory_replacement: bool = False


@dataclass(frozen=True)
class Goal:
    """A checked goal.

    Attributes:
        points: of its trajectory, times from the stamp on.
        tolerances: that hold for this goal, those of the goal over the defaults.
        start: its stamp in position ticks; None for now.
    """

    points: TrajectoryPoints
    tolerances: Tolerances
    start: int | None


def check_goal(
    message: Any, robot_joints: Sequence[str], defaults: Tolerances, options: GoalOptions, position_hz: int
) -> Goal:
    """Check a control_msgs/action/FollowJointTrajectory goal, or anything with its attributes.

    Needs no state of the controller and may run in any thread; what depends on it is checked by `GoalRunner.offer`.

    Raises:
        GoalError: INVALID_JOINTS for names that are empty, unknown, repeated or missing, in the trajectory or in
            tolerances; else INVALID_GOAL.
    """
    raise NotImplementedError
