"""What becomes of a goal that is followed: over DDS, two clients, both nodes, time that runs by steps."""

from __future__ import annotations

import re

import numpy as np
import pytest
from action_bench import STEP, SUCCEEDED, Bench
from ros_client import JOINTS

pytestmark = pytest.mark.ros


def test_names_and_types_are_those_of_the_original(bench: Bench) -> None:
    """Action, topics and service are where clients of joint_trajectory_controller look for them, with their types."""
    from rclpy.action import get_action_names_and_types

    node = bench.client.node
    actions = dict(get_action_names_and_types(node))
    assert actions["/rx90_controller/follow_joint_trajectory"] == ["control_msgs/action/FollowJointTrajectory"]
    topics, services = dict(node.get_topic_names_and_types()), dict(node.get_service_names_and_types())
    assert topics["/rx90_controller/joint_trajectory"] == ["trajectory_msgs/msg/JointTrajectory"]
    assert topics["/rx90_controller/controller_state"] == ["control_msgs/msg/JointTrajectoryControllerState"]
    assert topics["/rx90_controller/speed_scaling_input"] == ["control_msgs/msg/SpeedScalingFactor"]
    assert services["/rx90_controller/query_state"] == ["control_msgs/srv/QueryTrajectoryState"]


def test_its_parameter_file_serves(bench: Bench) -> None:
    """What is in a file for joint_trajectory_controller and has no counterpart is one line; the rest holds."""
    (line,) = [line for line in bench.cell.output.splitlines() if "joint_trajectory_controller" in line]
    names = "cmd_timeout, command_interfaces, gains.joint_1.d, gains.joint_1.ff_velocity_scale, gains.joint_1.i, "
    names += "gains.joint_1.i_clamp, gains.joint_1.p, interpolation_method, state_interfaces; "
    assert "[WARN]" in line
    assert f"not used, parameters of joint_trajectory_controller: {names}" in line


def test_a_goal_is_followed_and_told_of(bench: Bench) -> None:
    """A goal succeeds at its last point, which stays; every 50 ms of simulated time its client hears how it goes."""
    from action_client import move

    bench.home()
    begin = bench.now + STEP
    ended = bench.follow(move(0.05, 0.4, start=begin))
    assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
    assert re.fullmatch(r"goal reached at [\d.]+ s, [\d.e-]+ s after the last point", ended.result.error_string)
    bench.client.spin_until(lambda: len(bench.goals.feedback) >= 8, "what was told of it")
    times = [f.header.stamp.sec + f.header.stamp.nanosec * 1e-9 for f in bench.goals.feedback]
    assert np.diff(times) == pytest.approx(0.05)
    for feedback in bench.goals.feedback:
        assert list(feedback.joint_names) == JOINTS
        desired, actual, error = (
            np.array(getattr(feedback, name).positions) for name in ("desired", "actual", "error")
        )
        assert error == pytest.approx(desired - actual, abs=1e-15)
        since = feedback.desired.time_from_start
        assert since.sec + since.nanosec * 1e-9 == pytest.approx(
            feedback.header.stamp.sec + feedback.header.stamp.nanosec * 1e-9 - begin, abs=1e-9
        )
    bench.time.run(0.2)
    assert list(bench.heard()[-1].position) == pytest.approx([0.05] * 6, abs=1e-12)


def test_a_goal_where_the_arm_is_already_succeeds_at_once(bench: Bench) -> None:
    """What planners return for it, one point at time 0, is reached in a tick: nothing moves."""
    from action_client import move

    bench.home()
    before = bench.now
    ended = bench.follow(move(1e-7, 0.0))
    assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
    at = re.match(r"goal reached at ([\d.]+) s", ended.result.error_string)
    assert at is not None
    assert float(at[1]) <= before + 0.01
    bench.time.run(0.02)
    assert not bench.velocities().any()


def test_a_goal_is_followed_better_by_a_model_of_the_friction(bench: Bench) -> None:
    """Switched on as parameters between two goals, friction model and inverse dynamics leave less than half."""
    from action_client import move

    def worst() -> float:
        bench.home()
        ended = bench.follow(move(0.05, 0.4, start=bench.now + STEP))
        assert (ended.status, ended.result.error_code) == (SUCCEEDED, 0)
        bench.client.spin_until(lambda: len(bench.goals.feedback) >= 8, "what was told of it")
        return max(float(np.abs(feedback.error.positions).max()) for feedback in bench.goals.feedback)

    without = worst()
    switches = [f"feed_forward__{part}" for part in ("inverse_dynamics", "friction_model")]
    try:
        assert bench.client.set_parameters("rx90_controller", **dict.fromkeys(switches, True)) == ["", ""]
        assert worst() < 0.5 * without
    finally:
        assert bench.client.set_parameters("rx90_controller", **dict.fromkeys(switches, False)) == ["", ""]


def test_ten_thousand_points(bench: Bench) -> None:
    """A goal of 10,000 points is followed through all of them; so is a trajectory on the topic, in the same bits."""
    from action_client import goal, point
    from trajectory_msgs.msg import JointTrajectory

    bench.home()
    begin, times = bench.now + 0.1, np.arange(1, 10_001) * 1e-4
    shape = 0.05 * (10 * times**3 - 15 * times**4 + 6 * times**5)  # at rest at both ends
    speed = 0.05 * (30 * times**2 - 60 * times**3 + 30 * times**4)
    speed[-1] = 0.0
    points = [point(t, [q] * 6, [v] * 6) for t, q, v in zip(times, shape, speed, strict=True)]
    assert bench.follow(goal(*points, start=begin)).status == SUCCEEDED
    passed = bench.set_points_from(begin, 1000)
    assert np.abs(passed - shape[9::10][:, None]).max() < 1e-9

    bench.home()
    begin = bench.now + 0.1  # the client may not have heard of the last ticks
    topic = bench.client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1)
    bench.client.spin_until(lambda: topic.get_subscription_count() > 0, "the controller")
    topic.publish(goal(*points, start=begin).trajectory)
    bench.said("trajectory accepted: 10000 points")
    bench.time.run(1.1 + 2 * STEP)
    assert np.array_equal(bench.set_points_from(begin, 1000), passed)
