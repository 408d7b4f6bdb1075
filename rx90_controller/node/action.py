"""What clients of joint_trajectory_controller find on the controller node, if control_msgs is there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.node import Node

from rx90_common.exchange.control_messages import missing_control_msgs
from rx90_common.exchange.tick_channel import TickChannel
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.goal_parameters import GoalParameters
from rx90_controller.node.servo_loop import ServoLoop

if TYPE_CHECKING:
    from rx90_controller.node.action_server import FollowJointTrajectoryAction


def make_action(
    node: Node, loop: ServoLoop, parameters: GoalParameters, cs7b: CS7B, channel: TickChannel
) -> FollowJointTrajectoryAction | None:
    """Serve the action; without control_msgs say once how to get it, and return None."""
    missing = missing_control_msgs()
    if missing is not None:
        node.get_logger().info(f"the action follow_joint_trajectory is off: {missing}")
        return None
    from rx90_controller.node.action_server import FollowJointTrajectoryAction

    return FollowJointTrajectoryAction(
        node, loop, parameters.tolerances, cs7b.rates, lambda: channel.matches().publishers > 0
    )
