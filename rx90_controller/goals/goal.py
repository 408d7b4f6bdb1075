"""A goal of FollowJointTrajectory, checked: control_msgs/action/FollowJointTrajectory, needs no rclpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import message_time_ns
from rx90_controller.goals.results import GoalError, ResultCode
from rx90_controller.goals.tolerances import GoalTolerances
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.message import check_joint_names, points_from_message, start_tick
from rx90_controller.trajectory.planning import Entrance

_NOT_SERVED = ("component_path_tolerance", "component_goal_tolerance")


@dataclass(frozen=True)
class GoalOptions:
    """What else is accepted; the first three as the parameters of joint_trajectory_controller.

    Attributes:
        allow_partial_joints_goal: a goal may name some of the joints; the others hold their set-point, and brake to
            rest before if they move (with `allow_trajectory_replacement` they go on along their trajectory).
        allow_nonzero_velocity_at_trajectory_end: the last point may have a velocity; unless another trajectory follows,
            each joint brakes behind it.
        allow_trajectory_replacement: the first point may lie elsewhere than the set-point at the start: points that are
            not later than the start are left out, and the motion goes to the next one from where the path is then.
        velocities_from_positions: velocities between the first and the last point are computed from the positions, as
            `TrajectoryPoints.smoothed` says, in place of those that points carry.
    """

    allow_partial_joints_goal: bool = False
    allow_nonzero_velocity_at_trajectory_end: bool = False
    allow_trajectory_replacement: bool = False
    velocities_from_positions: bool = False


@dataclass(frozen=True)
class Goal:
    """A checked goal.

    Attributes:
        points: of its trajectory, times from the stamp on; prepared, because they are taken between two ticks.
        tolerances: that hold for this goal, those of the goal over the defaults.
        start: its stamp in position ticks; None for now.
    """

    points: TrajectoryPoints
    tolerances: GoalTolerances
    start: int | None

    def entrance(self, options: GoalOptions) -> Entrance:
        """Return how it comes into the generator."""
        return Entrance(self.points, self.start, anywhere=options.allow_trajectory_replacement)


def check_goal(
    message: Any, robot_joints: Sequence[str], defaults: GoalTolerances, options: GoalOptions, position_hz: int
) -> Goal:
    """Check a control_msgs/action/FollowJointTrajectory goal, or anything with its attributes.

    Needs no state of the controller and may run in any thread; what depends on it is checked by `GoalRunner.offer`.

    Args:
        message: the goal.
        robot_joints: names of the six joints.
        defaults: tolerances where the goal has none of its own.
        options: what else is accepted.
        position_hz: rate of the position loop, Hz.

    Raises:
        GoalError: INVALID_JOINTS for names that are empty, unknown, repeated or missing, in the trajectory or in
            tolerances; else INVALID_GOAL.
    """
    trajectory = message.trajectory
    if message.multi_dof_trajectory.joint_names or message.multi_dof_trajectory.points:
        raise GoalError(ResultCode.INVALID_GOAL, "multi_dof_trajectory is given; accepted: an empty one")
    for name in _NOT_SERVED:
        if getattr(message, name):
            raise GoalError(ResultCode.INVALID_GOAL, f"{name} of {len(getattr(message, name))} joints; accepted: none")
    partial = options.allow_partial_joints_goal
    try:
        check_joint_names(robot_joints, trajectory, partial=partial)
    except TrajectoryError as error:
        raise GoalError(ResultCode.INVALID_JOINTS, str(error)) from error
    goal_time = message_time_ns(message.goal_time_tolerance) / NANOSECONDS
    tolerances = defaults.of_goal(message.path_tolerance, message.goal_tolerance, goal_time)
    moving_end, smooth = options.allow_nonzero_velocity_at_trajectory_end, options.velocities_from_positions
    try:
        points = points_from_message(robot_joints, trajectory, partial=partial, moving_end=moving_end, smooth=smooth)
    except TrajectoryError as error:
        raise GoalError(ResultCode.INVALID_GOAL, str(error)) from error
    return Goal(points.prepared(), tolerances, start_tick(trajectory, position_hz))
