"""What `prepare` sets and leaves alone; control_msgs: what is said where it is missing, and its types over DDS."""

from __future__ import annotations

import ctypes
import os
import sys
import xml.etree.ElementTree as ET
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

from rx90_common.base.errors import ConfigError
from rx90_common.exchange.ros_start import missing_control_msgs, prepare

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PEER = Path(__file__).parents[2] / "support" / "control_msgs_peer.py"
NAMES = (PROFILES, RANGE, "FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION", "ROS_STATIC_PEERS")


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Empty the variables; whatever `prepare` sets is taken back."""
    for name in NAMES:
        monkeypatch.setenv(name, "")  # so that monkeypatch remembers each of them
        monkeypatch.delenv(name)
    return monkeypatch


def now() -> dict[str, str]:
    """Return the variables that are set."""
    return {name: os.environ[name] for name in NAMES if name in os.environ}


@pytest.mark.usefixtures("environment")
def test_on_a_network_udp_and_the_shipped_profiles_are_chosen() -> None:
    """Without a discovery range the range stays ROS's own, on UDP, with a profile file that exists."""
    prepare()
    assert set(now()) == {PROFILES, "FASTDDS_BUILTIN_TRANSPORTS"}
    assert Path(now()[PROFILES]).name == "profiles.xml"
    assert Path(now()[PROFILES]).is_file()


@pytest.mark.usefixtures("environment")
def test_localhost_is_a_profile_of_its_own() -> None:
    """LOCALHOST, with which ROS would add shared memory, becomes a profile on 127.0.0.1, but not with static peers."""
    os.environ[RANGE] = "localhost"
    prepare()
    assert now()[RANGE] == "SYSTEM_DEFAULT"
    assert Path(now()[PROFILES]).name == "localhost.xml"
    first = now()
    prepare()  # as a child process does
    assert now() == first
    del os.environ[PROFILES]
    own = {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"}  # which reach further
    os.environ.update(own)
    prepare()
    assert {name: now()[name] for name in own} == own


@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize(
    "own",
    [
        {PROFILES: "/my/profiles.xml", RANGE: "LOCALHOST"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"},
    ],
)
def test_what_the_user_has_set_stays(own: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Profiles of the user's own and another middleware are left as they are."""
    monkeypatch.setattr(ctypes, "CDLL", lambda _name: None)  # any middleware is installed
    os.environ.update(own)
    prepare()
    assert now() == own


@pytest.mark.usefixtures("environment")
def test_both_profiles_have_the_same_writers() -> None:
    """The two files differ in the transport, never in how the topics of the ticks are repaired and kept."""
    names = []
    for range_name in ("LOCALHOST", "SUBNET"):
        os.environ.pop(PROFILES, None)
        os.environ[RANGE] = range_name
        prepare()
        tree = ET.parse(now()[PROFILES])
        for element in tree.iter():
            element.tail = element.text = (element.text or "").strip() or None
        space = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
        names.append([ET.tostring(writer) for writer in tree.iter(f"{space}data_writer")])
    assert names[0] == names[1]
    assert len(names[0]) == 3


@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [
        ("ROS_DOMAIN_ID", "233", "0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "0 to 232"),
        ("ROS_DOMAIN_ID", "home", "0 to 232"),
        ("RMW_IMPLEMENTATION", "rmw_nothing_cpp", "rmw_fastrtps_cpp"),
    ],
)
def test_what_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str, accepted: str) -> None:
    """A domain without ports and a middleware that is not installed are named with what is accepted."""
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=f"{name} is '{value}'.*{accepted}"):
        prepare()


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
