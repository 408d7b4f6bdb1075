"""What is no goal, and when the controller takes none: rejected or aborted, with the reason; bursts and streams."""

from typing import Any

import numpy as np
import pytest
from action_bench import ABORTED, CANCELED, STEP, SUCCEEDED, Bench
from diagnostic_msgs.msg import DiagnosticArray
from processes import TIMEOUT
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from ros_client import JOINTS
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from rx90_common.exchange.endpoints import ros_time

pytestmark = pytest.mark.ros


def test_what_is_no_goal_is_rejected_and_logged_and_the_one_before_goes_on(bench: Bench) -> None:
    """Bad goals, of which test_goals.py has every kind, get a line each; the goal before is not touched."""
    from action_client import goal, move, point

    bench.home()
    bench.time.run(0.2)
    first = bench.goals.send(move(0.05, 0.4))
    result = bench.goals.result_of(first)
    bench.time.run(0.05)
    diagnostics = bench.client.listen("/diagnostics", DiagnosticArray, depth=10)

    def last_rejection() -> str:
        values = [value for message in diagnostics for status in message.status for value in status.values]
        return str(next((value.value for value in reversed(values) if value.key == "last rejection"), ""))

    end = point(1.0, [0.0] * 6)
    for message, words in (
        (goal(end, names=["a", *JOINTS[1:]]), "unknown joint 'a'"),
        (move(0.0, 0.1, start=bench.now - 0.11), "the last point is at"),
    ):
        before = bench.cell.output.count("goal rejected")
        assert not bench.others.send(message).accepted
        bench.client.spin_until(lambda: bench.cell.output.count("goal rejected") > before, words)  # noqa: B023 - called at once
        (line,) = [line for line in bench.cell.output.splitlines() if "goal rejected" in line][before:]
        assert words in line
    at = f"goal at {bench.now:.3f} s: {line.partition('rejected: ')[2]}"
    bench.client.spin_until(lambda: last_rejection() == at, "the last of them in the diagnostics")
    assert bench.time.until(result).status == SUCCEEDED
    bench.home()
    handle = bench.goals.send(goal(point(0.0, [0.1] * 6), point(1.0, [0.1] * 6)))
    ended = bench.goals.wait(bench.goals.result_of(handle))
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert "joint_1 starts at 0.1 rad" in ended.result.error_string
    bench.time.run(0.05)
    assert not bench.velocities().any()


def test_brakes_end_a_goal_and_refuse_the_next(bench: Bench) -> None:
    """With the torque off the goal is aborted with INVALID_GOAL, at once; goals are rejected until it is on again."""
    from action_client import move

    def switch(on: bool, by_node: bool) -> None:
        if by_node:
            assert bench.client.transition("rx90_controller", "activate" if on else "deactivate")
        else:
            bench.client.enable(on)

    for by_node, end, reason in (
        (False, "the torque is off, at ", "disabled; accepted: after a call of ~/enable with true"),
        (True, "the controller is deactivated, the torque is off, at ", "inactive; accepted: in state active"),
    ):
        bench.home()
        result = bench.goals.result_of(bench.goals.send(move(0.05, 0.4)))
        bench.time.run(0.1)
        switch(False, by_node)
        ended = bench.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (ABORTED, -1)
        assert ended.result.error_string.startswith(end)
        bench.time.run(STEP)
        assert not bench.goals.send(move(0.0)).accepted
        bench.said(f"goal rejected: the controller is {reason}")
        switch(True, by_node)
        bench.time.run(STEP)
    bench.home()
    for on in (False, True):
        bench.client.enable(on)
    # It waits for the tick with which the torque comes back.
    assert bench.time.until(bench.goals.result_of(bench.goals.send(move(0.02, 0.3)))).status == SUCCEEDED


def wave(time: float) -> list[float]:
    return [0.02 * (1.0 - float(np.cos(4.0 * np.pi * time)))] * 6


def test_stamped_set_points_are_passed_through_after_the_delay_bit_by_bit(bench: Bench) -> None:
    """In lock-step each is met `stream.delay` after its stamp, and the same ones give the same bits again."""
    publisher = bench.client.node.create_publisher(JointState, "rx90_controller/joint_setpoints", 20)
    bench.client.spin_until(lambda: publisher.get_subscription_count() > 0, "the controller")
    found, delay = [], 0.03
    for _ in range(2):
        bench.begin_anew()
        begin = bench.now
        for k in range(1, 20):
            message = JointState(name=JOINTS, position=wave(k * STEP))
            message.header.stamp = ros_time(round((begin + k * STEP) * 1e9))
            publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT))
        for _ in range(20):  # in the round in which it answers a request, its executor takes one waiting set-point
            bench.client.known_to("rx90_controller")
        bench.time.run(0.3)
        found.append(bench.set_points_from(begin, 299))
    bench.client.node.destroy_publisher(publisher)
    due = [round((k * STEP + delay) * 1e3) - 1 for k in range(3, 19)]
    assert np.abs(found[0][due] - [wave(k * STEP) for k in range(3, 19)]).max() < 1e-5
    assert np.array_equal(*found)
    assert "came" not in bench.cell.output.rpartition("stream begins")[2]


BURST = 200
REQUESTS = 100
SOON = 40.0  # s; resets that waited for each other's first tick would take 50
DEEP = QoSProfile(depth=2 * BURST)  # the client's own queues, of answers that come while it sends


def answers(bench: Bench, asked: list[Any], what: str) -> list[Any]:
    bench.client.spin_until(lambda: all(one.done() for one in asked), f"{len(asked)} {what}", SOON)
    return [one.result() for one in asked]


def test_goals_results_and_cancels_of_a_burst_are_all_answered(bench: Bench) -> None:
    """200 goals at once; then as many requests for results, and for cancels: the last goal's is the only one to do."""
    from action_client import move
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient

    deep = {f"{of}_service_qos_profile": DEEP for of in ("goal", "result", "cancel")}
    name = "rx90_controller/follow_joint_trajectory"
    action = ActionClient(bench.client.node, FollowJointTrajectory, name, **deep)
    bench.client.spin_until(action.server_is_ready, "the action's server")
    bench.home()
    handles = answers(bench, [action.send_goal_async(move(0.05, 0.5)) for _ in range(BURST)], "goals")
    assert all(handle.accepted for handle in handles)
    results = [handle.get_result_async() for handle in handles]
    told = answers(bench, [handle.cancel_goal_async() for handle in handles], "cancels")
    assert [len(one.goals_canceling) for one in told] == [0] * (BURST - 1) + [1]
    assert [one.status for one in answers(bench, results, "results")] == [ABORTED] * (BURST - 1) + [CANCELED]
    bench.time.run(0.4)
    action.destroy()


def test_requests_of_a_burst_are_all_answered(bench: Bench) -> None:
    """100 at once to the simulation and to the controller, while time stands still, and while it runs."""
    node = bench.client.node
    for paused in (True, False):
        bench.time.pause(paused)
        for kind, service, request in (
            (Trigger, "rx90_sim/reset", Trigger.Request()),
            (SetBool, "rx90_controller/enable", SetBool.Request(data=True)),
        ):
            client = node.create_client(kind, service, qos_profile=DEEP)
            bench.client.spin_until(client.service_is_ready, service)
            told = answers(bench, [client.call_async(request) for _ in range(REQUESTS)], service)
            assert all(one.success for one in told)
            node.destroy_client(client)
        bench.time.pause(True)
        bench.begin_anew()
