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
    from rx90_controller.node.controller_state import ControllerState


def make_action(node: Node, loop: ServoLoop, cs7b: CS7B, channel: TickChannel) -> FollowJointTrajectoryAction | None:
    """Serve the action and what belongs to it; without control_msgs say once how to get it, and return None."""
    missing = missing_control_msgs()
    if missing is not None:
        node.get_logger().info(f"the action follow_joint_trajectory is off: {missing}")
        return None
    from rx90_controller.node.action_server import FollowJointTrajectoryAction
    from rx90_controller.node.speed_scaling import SpeedScaling
    from rx90_controller.node.state_query import StateQuery

    SpeedScaling(node, loop)
    StateQuery(node, loop, cs7b)
    return FollowJointTrajectoryAction(
        node, loop, cs7b.joint_names, cs7b.rates, lambda: channel.matches().publishers > 0
    )


def make_controller_state(node: Node, cs7b: CS7B, parameters: GoalParameters) -> ControllerState | None:
    """Return what publishes the controller's state; None without control_msgs."""
    if missing_control_msgs() is not None:
        return None
    from rx90_controller.node.controller_state import ControllerState

    return ControllerState(node, cs7b, parameters.state_ticks)
