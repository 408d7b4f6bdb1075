"""Bursts of requests: each is answered, or refused at once; none is dropped on its way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from action_bench import ABORTED, CANCELED, Bench
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.ros

GOALS, REQUESTS = 200, 100
SOON = 40.0  # s; resets that waited for each other's first tick would take 50
DEEP = QoSProfile(depth=2 * GOALS)  # the client's own queues, of answers that come while it sends


@pytest.fixture
def action(bench: Bench) -> Iterator[Any]:
    """Give a client of the action that keeps all answers."""
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient

    client = ActionClient(
        bench.client.node,
        FollowJointTrajectory,
        "rx90_controller/follow_joint_trajectory",
        goal_service_qos_profile=DEEP,
        result_service_qos_profile=DEEP,
        cancel_service_qos_profile=DEEP,
    )
    bench.client.spin_until(client.server_is_ready, "the action's server")
    yield client
    client.destroy()


def answers(bench: Bench, asked: list[Any], what: str) -> list[Any]:
    """Return the answers of all."""
    bench.client.spin_until(lambda: all(one.done() for one in asked), f"{len(asked)} {what}", SOON)
    return [one.result() for one in asked]


def test_goals_results_and_cancels_of_a_burst_are_all_answered(bench: Bench, action: Any) -> None:
    """200 goals at once; then as many requests for results, and for cancels: the last goal's is the only one to do."""
    from action_client import move

    bench.home()
    message = move(0.05, 0.5)
    handles = answers(bench, [action.send_goal_async(message) for _ in range(GOALS)], "goals")
    assert all(handle.accepted for handle in handles)
    results = [handle.get_result_async() for handle in handles]
    told = answers(bench, [handle.cancel_goal_async() for handle in handles], "cancels")
    assert [len(one.goals_canceling) for one in told] == [0] * (GOALS - 1) + [1]
    ended = answers(bench, results, "results")
    assert [one.status for one in ended] == [ABORTED] * (GOALS - 1) + [CANCELED]
    bench.time.run(0.4)


@pytest.mark.parametrize("paused", [True, False])
def test_requests_of_a_burst_are_all_answered(bench: Bench, paused: bool) -> None:
    """100 at once to the simulation and to the controller, while time stands still, and while it runs."""
    node = bench.client.node
    clients = [
        (node.create_client(Trigger, "rx90_sim/reset", qos_profile=DEEP), Trigger.Request()),
        (node.create_client(SetBool, "rx90_controller/enable", qos_profile=DEEP), SetBool.Request(data=True)),
    ]
    bench.time.pause(paused)
    for client, request in clients:
        bench.client.spin_until(client.service_is_ready, client.srv_name)
        told = answers(bench, [client.call_async(request) for _ in range(REQUESTS)], client.srv_name)
        assert all(one.success for one in told)
        node.destroy_client(client)
    bench.time.pause(True)
    bench.begin_anew()
