"""control_msgs: what is said where it is missing, and its types between two processes over DDS."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from processes import TIMEOUT, Processes
from ros_client import own_node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.exchange.control_messages import missing_control_msgs

PEER = Path(__file__).parents[2] / "support" / "control_msgs_peer.py"


@pytest.mark.parametrize(
    ("distribution", "accepted"),
    [("", "make action, in the project's folder"), ("jazzy", "sudo apt install ros-jazzy-control-msgs")],
)
def test_missing_types_are_one_line_that_says_how_to_get_them(
    distribution: str, accepted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without control_msgs the line names it and the command: the project's own, or apt's where ROS is sourced."""
    monkeypatch.setattr(sys, "path", [])
    for name in [name for name in sys.modules if name.partition(".")[0] == "control_msgs"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setenv("ROS_DISTRO", distribution)
    assert missing_control_msgs() == f"needs control_msgs, which is not installed; accepted: {accepted}"


@pytest.fixture
def node(needs_action: None, ros_domain: int, processes: Processes) -> Iterator[Any]:  # noqa: ARG001 - it must be there
    """Give a node in this process while another process serves."""
    processes.start(sys.executable, PEER).wait_for("serving")
    with own_node("asking", ros_domain) as own:
        yield own


@pytest.mark.ros
def test_action_state_and_query_cross_dds_whole(node: Any) -> None:
    """Another process gets a goal and its cancellation; feedback, result, state and answer come back as they were."""
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
    from control_msgs.srv import QueryTrajectoryState
    from rclpy.action import ActionClient

    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def wait_for(future: Any) -> Any:
        executor.spin_until_future_complete(future, TIMEOUT)
        assert future.done()
        return future.result()

    point = JointTrajectoryPoint(positions=[0.1, -0.2], velocities=[0.0, 3e-300], time_from_start=Duration(sec=7))
    goal = FollowJointTrajectory.Goal(
        trajectory=JointTrajectory(joint_names=["joint_1", "joint_2"], points=[point]),
        path_tolerance=[JointTolerance(name="joint_2", position=-1.0)],
        goal_time_tolerance=Duration(sec=5),
    )
    client = ActionClient(node, FollowJointTrajectory, "follow_joint_trajectory")
    assert client.wait_for_server(TIMEOUT)
    heard: Any = rclpy.task.Future(executor=executor)
    handle = wait_for(client.send_goal_async(goal, feedback_callback=heard.set_result))
    feedback = wait_for(heard).feedback
    assert feedback == FollowJointTrajectory.Feedback(joint_names=["joint_1", "joint_2"], desired=point)
    assert len(wait_for(handle.cancel_goal_async()).goals_canceling) == 1
    ended = wait_for(handle.get_result_async())
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert (ended.result.error_code, ended.result.error_string) == (-4, "joint_2 -1.0 5")

    state = JointTrajectoryControllerState(joint_names=["joint_1"], output=point, speed_scaling_factor=0.25)
    back: Any = rclpy.task.Future(executor=executor)
    node.create_subscription(JointTrajectoryControllerState, "state_back", back.set_result, 1)
    publisher = node.create_publisher(JointTrajectoryControllerState, "state", 1)
    node.create_timer(0.02, lambda: publisher.publish(state))  # discovery may take a moment
    assert wait_for(back) == state

    query = node.create_client(QueryTrajectoryState, "query_state")
    assert query.wait_for_service(TIMEOUT)
    answer = wait_for(query.call_async(QueryTrajectoryState.Request(time=Time(sec=11))))
    assert (answer.success, answer.name, list(answer.position)) == (True, ["joint_1"], [11.0])
    executor.shutdown()
