"""Goals of one seed over DDS, by two clients, each at a random moment of the one before: refused, or followed.

The environment variable ACTION_SEED gives other ones.
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
from ros_client import JOINTS, seconds

from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.ros

SEED, GOALS = int(os.environ.get("ACTION_SEED", "20")), 60
LINE = re.compile(r"goal (rejected|succeeded|aborted|canceled): (.*)")


def random_goal(generator: Generator, now: float, pose: np.ndarray, acceleration: np.ndarray) -> tuple[Any, bool]:
    """Return a goal of some points within a few hundredths of a second, and whether it is none."""
    from action_client import goal, point

    spans = generator.uniform(0.03, 0.15) * generator.dirichlet(np.full(generator.integers(1, 4), 5.0))
    # A motion from rest to rest of d in T needs at least 4 d/T^2, and one with a cubic 6 d/T^2.
    share = generator.choice([0.02, 0.1, 0.3, 2.0], p=[0.3, 0.4, 0.2, 0.1])
    points = []
    for span, time in zip(spans, np.cumsum(spans), strict=True):
        pose = pose + share * acceleration * span**2 / 6.0 * generator.uniform(-1.0, 1.0, 6)
        points.append(point(time, pose.tolist()))
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
    for _ in range(GOALS):
        pose = np.array(bench.heard()[-1].position)
        message, damaged = random_goal(generator, bench.now, pose, limits.acceleration)
        goals = (bench.goals, bench.others)[generator.integers(2)]
        handle = goals.send(message)
        assert handle.accepted is not damaged
        futures += [goals.result_of(handle)] if handle.accepted else []
        bench.time.run(STEP * generator.choice(8, p=[0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05]))
        if handle.accepted and generator.random() < 0.2:
            goals.cancel(handle)
            bench.time.run(STEP * generator.integers(0, 3))
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
