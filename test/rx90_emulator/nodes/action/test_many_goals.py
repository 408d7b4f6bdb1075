"""Many goals and requests: at random moments, and in bursts; each is answered, and no set-point jumps.

The environment variable ACTION_SEED gives other ones of the goals at random.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from typing import Any

import numpy as np
import pytest
from action_bench import ABORTED, CANCELED, STEP, SUCCEEDED, Bench
from numpy.random import Generator
from rclpy.qos import QoSProfile
from ros_client import JOINTS, seconds

from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.ros

SEED, GOALS = int(os.environ.get("ACTION_SEED", "20")), 40
LINE = re.compile(r"goal (rejected|succeeded|aborted|canceled): (.*)")


def random_goal(
    generator: Generator, now: float, pose: np.ndarray, acceleration: np.ndarray, bare: bool
) -> tuple[Any, bool]:
    """Return a goal of some points within a few hundredths of a second, bare of velocities, and whether it is none."""
    from action_client import goal, point

    spans = generator.uniform(0.03, 0.15) * generator.dirichlet(np.full(generator.integers(1, 4), 5.0))
    # A motion from rest to rest of d in T needs at least 4 d/T^2, and one with a cubic 6 d/T^2.
    share = generator.choice([0.02, 0.1, 0.3, 2.0], p=[0.3, 0.4, 0.2, 0.1])
    points = []
    for span, time in zip(spans, np.cumsum(spans), strict=True):
        pose = pose + share * acceleration * span**2 / 6.0 * generator.uniform(-1.0, 1.0, 6)
        points.append(point(time, pose.tolist()))
        if bare:
            points[-1].velocities = []
    start = max(0.0, now + generator.uniform(-0.03, 0.03)) if generator.random() < 0.3 else 0.0
    message = goal(*points, start=start)
    damaged = bool(generator.random() < 0.3)
    if damaged:
        trajectory = message.trajectory
        match generator.integers(4):
            case 0:
                trajectory.joint_names = [*JOINTS[:5], str(generator.choice(["", "elbow", "joint 1\n"]))]
            case 1:
                points[0].positions = [float(generator.choice([np.nan, np.inf])), *points[0].positions[1:]]
            case 2:
                points[0].velocities = [0.0] * 5
            case _:
                trajectory.points = [*points, point(0.0, points[-1].positions)]
    return message, damaged


def test_each_goal_has_one_defined_answer_and_no_set_point_jumps(bench: Bench, shipped: Setup) -> None:
    """What is no goal is rejected; each other one has one result with code, text and line; set-points keep limits.

    Over all goals and ends, at each tick: positions within limits, second differences within the accelerations.
    """
    limits, generator = shipped.controller.limits(shipped.robot), np.random.default_rng(SEED)
    bench.begin_anew()
    before = len(LINE.findall(bench.cell.output))
    futures = []
    for number in range(GOALS):
        bare = number >= GOALS // 2
        assert bench.client.set_parameters("rx90_controller", velocities_from_positions=bare) == [""]
        pose = np.array(bench.heard()[-1].position)
        message, damaged = random_goal(generator, bench.now, pose, limits.acceleration, bare)
        goals = (bench.goals, bench.others)[generator.integers(2)]
        handle = goals.send(message)
        assert handle.accepted is not damaged
        futures += [goals.result_of(handle)] if handle.accepted else []
        bench.time.run(STEP * generator.choice(8, p=[0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05]))
        if handle.accepted and generator.random() < 0.2:
            goals.cancel(handle)
            bench.time.run(STEP * generator.integers(0, 3))
    assert bench.client.set_parameters("rx90_controller", velocities_from_positions=False) == [""]
    bench.time.run(0.5)
    bench.client.spin_until(lambda: all(future.done() for future in futures), "all results")
    bench.client.spin_until(lambda: len(LINE.findall(bench.cell.output)) >= before + GOALS, "a line for each goal")
    lines = LINE.findall(bench.cell.output)[before:]
    reasons = [text for what, text in lines if what == "rejected"]
    assert len(reasons) == GOALS - len(futures)
    assert all("; accepted: " in reason for reason in reasons)
    codes = {SUCCEEDED: {0}, CANCELED: {0}, ABORTED: {-1, -4, -5}}
    named = {SUCCEEDED: "succeeded", CANCELED: "canceled", ABORTED: "aborted"}
    ended = [future.result() for future in futures]
    assert all(one.result.error_code in codes[one.status] for one in ended)
    told = Counter((named[one.status], one.result.error_string) for one in ended)
    assert told == Counter(line for line in lines if line[0] != "rejected")
    assert {what for what, _ in lines} == {"rejected", *named.values()}  # each end is there

    assert np.diff([seconds(message) for message in bench.heard()]) == pytest.approx(1e-3)
    position = np.array([message.position for message in bench.heard()])
    assert ((limits.lower <= position) & (position <= limits.upper)).all()
    shown = np.abs(np.diff(position, 2, axis=0)).max(axis=0) / 1e-6, bench.fastest_change()
    assert 0.9 < (np.maximum(*shown) / limits.acceleration).max() <= 1.0 + 1e-3  # near the limits, and not beyond
    bench.begin_anew()


BURST, REQUESTS = 200, 100
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
