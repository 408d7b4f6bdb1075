"""Goals, requests for results and cancels in bursts: each is answered."""

from __future__ import annotations

from typing import Any

import pytest
from action_bench import ABORTED, CANCELED, Bench
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.ros

BURST = 200
REQUESTS = 100
SOON = 40.0  # s; resets that waited for each other's first tick would take 50
DEEP = QoSProfile(depth=2 * BURST)  # the client's own queues, of answers that come while it sends


def answers(bench: Bench, asked: list[Any], what: str) -> list[Any]:
    """Return the answers of all."""
    bench.client.spin_until(lambda: all(one.done() for one in asked), f"{len(asked)} {what}", SOON)
    return [one.result() for one in asked]


def test_goals_results_and_cancels_of_a_burst_are_all_answered(bench: Bench) -> None:
    """200 goals at once; then as many requests for results, and for cancels: the last goal's is the only one to do."""
    from action_client import move
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient

    deep = {f"{of}_service_qos_profile": DEEP for of in ("goal", "result", "cancel")}
    action = ActionClient(
        bench.client.node, FollowJointTrajectory, "rx90_controller/follow_joint_trajectory", **deep
    )  # fmt: skip
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
