"""A process that gives back what it gets in types of control_msgs: a goal as feedback and result, a state, a time."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState
from control_msgs.srv import QueryTrajectoryState
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor


def execute(handle: Any) -> FollowJointTrajectory.Result:
    """Give back a goal's names and point as feedback until it is cancelled, then its tolerances as the result."""
    goal = handle.request
    (point,) = goal.trajectory.points
    feedback = FollowJointTrajectory.Feedback(joint_names=goal.trajectory.joint_names, desired=point)
    while rclpy.ok() and not handle.is_cancel_requested:
        handle.publish_feedback(feedback)
        time.sleep(0.01)
    handle.canceled()
    (tolerance,) = goal.path_tolerance
    text = f"{tolerance.name} {tolerance.position} {goal.goal_time_tolerance.sec}"
    return FollowJointTrajectory.Result(
        error_code=FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, error_string=text
    )


def answer(request: Any, response: Any) -> Any:
    """Give back the time that is asked for, as a position."""
    response.success, response.name, response.position = True, ["joint_1"], [float(request.time.sec)]
    return response


def main() -> None:
    """Serve until Ctrl-C."""
    rclpy.init()
    node = rclpy.create_node("control_msgs_peer")
    state = node.create_publisher(JointTrajectoryControllerState, "state_back", 1)
    node.create_subscription(JointTrajectoryControllerState, "state", state.publish, 1)
    node.create_service(QueryTrajectoryState, "query_state", answer)
    server = ActionServer(
        node,
        FollowJointTrajectory,
        "follow_joint_trajectory",
        execute,
        callback_group=ReentrantCallbackGroup(),
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    print("serving", flush=True)
    try:
        rclpy.spin(node, MultiThreadedExecutor(2))
    except (KeyboardInterrupt, ExternalShutdownException):
        server.destroy()


main()
