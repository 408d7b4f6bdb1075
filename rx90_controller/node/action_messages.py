"""From what the controller knows of a goal to messages of control_msgs and trajectory_msgs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.message_times import ros_time
from rx90_controller.goals.execution import Feedback, Outcome


def feedback_message(feedback: Feedback, names: Sequence[str], tick_ns: int) -> Any:
    """Return a FollowJointTrajectory.Feedback; `tick_ns` is the period of the position loop."""
    return FollowJointTrajectory.Feedback(
        header=Header(stamp=ros_time(feedback.tick * tick_ns)),
        joint_names=list(names),
        desired=_point(feedback.desired, feedback.desired_time),
        actual=_point(feedback.actual, feedback.actual_time),
        error=_point(feedback.error, feedback.desired_time),
    )


def result_message(outcome: Outcome) -> Any:
    """Return a FollowJointTrajectory.Result."""
    return FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.text)


def _point(state: Array, seconds: float) -> JointTrajectoryPoint:
    sec, nanosec = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    position, velocity, acceleration = state.tolist()
    return JointTrajectoryPoint(
        positions=position,
        velocities=velocity,
        accelerations=acceleration,
        time_from_start=Duration(sec=sec, nanosec=nanosec),
    )
