"""150 goals of one seed over DDS, by clients in another process than the nodes: refused with a reason, or followed.

The environment variable ACTION_SEED gives other ones.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from processes import on_own_domain, running_processes
from rclpy.serialization import deserialize_message
from ros_client import Client
from sensor_msgs.msg import JointState
from warm_start import WarmPopen

from rx90_common.base.arrays import Array
from rx90_common.process.children import ChildProcess
from rx90_emulator.loop.setup import Setup

pytestmark = pytest.mark.ros

SEED, GOALS, TOGETHER = int(os.environ.get("ACTION_SEED", "20")), 150, 25
STEP = 0.01  # s
NODES = (
    *("-p", "rx90_sim:paused:=true", "-p", f"rx90_sim:step_ticks:={round(STEP * 4000)}"),
    *("-p", "rx90_sim:real_time_factor:=0.0"),
)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/GoalStatus


class Sent(NamedTuple):
    """A goal that was sent: what has to become of it, what is wrong with it, its result; None if it was rejected."""

    expected: str
    wrong: str
    result: Any


class Run:
    """What has become of all goals.

    Attributes:
        sent: all goals, in their order.
        position, velocity: set-points of every tick of the position loop, rad, rad/s, shape (n, 6).
        stamps: their simulated times, ns, shape (n,).
        output: of the nodes.
    """

    def __init__(self, client: Client, cell: ChildProcess, acceleration: Array) -> None:
        from action_client import GoalClient, Stepper

        self._client, self._cell, self._acceleration = client, cell, acceleration
        self._clients = [GoalClient(client), GoalClient(client)]
        self._time = Stepper(client, STEP)
        self._heard: list[bytes] = []
        client.node.create_subscription(JointState, "rx90_controller/reference", self._heard.append, 5000, raw=True)
        client.known_to("rx90_controller")
        self._time.run(STEP)
        self._generator = np.random.default_rng(SEED)
        self.sent: list[Sent] = []
        for _ in range(GOALS // TOGETHER):
            self._send_some()
        self._time.run(0.5)
        self._ended()
        messages = [deserialize_message(raw, JointState) for raw in self._all_heard()]
        self.stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])
        self.position = np.array([message.position for message in messages])
        self.velocity = np.array([message.velocity for message in messages])
        self.output = cell.output

    def _send_some(self) -> None:
        """Send goals with one choice of options, each at a random moment of the one before."""
        from random_goals import REJECTED, Options, Scene, random_goal

        generator, client = self._generator, self._client
        options = Options.random(generator)
        assert set(client.set_parameters("rx90_controller", **asdict(options))) == {""}
        for _ in range(TOGETHER):
            pose = np.array(deserialize_message(self._all_heard()[-1], JointState).position)
            scene = Scene(self._time.ran, pose, self._acceleration, options)
            message, expected, wrong = random_goal(generator, scene)
            goals = self._clients[generator.integers(2)]
            handle = goals.send(message)
            assert handle.accepted != (expected == REJECTED), wrong
            result = goals.result_of(handle) if handle.accepted else None
            self.sent.append(Sent(expected, wrong, result))
            self._time.run(STEP * generator.choice(8, p=[0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05]))
            if handle.accepted and generator.random() < 0.2:
                goals.cancel(handle)
                self._time.run(STEP * generator.integers(0, 3))

    def _all_heard(self) -> list[bytes]:
        """Return the set-points, up to that of the newest tick."""
        count = round(self._time.ran / 1e-3)
        self._client.spin_until(lambda: len(self._heard) >= count, f"{count} set-points, not {len(self._heard)}")
        return self._heard

    def _ended(self) -> None:
        """Wait for the last results and lines."""
        futures = [sent.result for sent in self.sent if sent.result is not None]
        self._client.spin_until(lambda: all(future.done() for future in futures), "all results")
        lines = re.compile(r"goal (?:rejected|succeeded|aborted|canceled)")
        self._client.spin_until(lambda: len(lines.findall(self._cell.output)) >= GOALS, "a line for each goal")


@pytest.fixture(scope="module")
def run(needs_action: None, tmp_path_factory: pytest.TempPathFactory, limits: Any) -> Iterator[Run]:  # noqa: ARG001 - it must be there
    """Give the run of all goals."""
    with ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr("subprocess.Popen", WarmPopen)
        stack.enter_context(on_own_domain(patch, tmp_path_factory.mktemp("random")))
        processes = stack.enter_context(running_processes())
        cell = processes.start("rx90_cell", "--ros-args", *NODES)
        yield Run(stack.enter_context(closing(Client())), cell, limits.acceleration)


@pytest.fixture(scope="module")
def limits(request: pytest.FixtureRequest) -> Any:
    """Return the limits that the controller's file and the URDF name."""
    setup: Setup = request.getfixturevalue("shipped")
    return setup.controller.limits(setup.robot)


def test_each_goal_has_one_defined_answer_with_a_reason(run: Run) -> None:
    """What is no goal is rejected; every other goal has one result with code and text; each ends in one line."""
    lines = re.findall(r"goal (rejected|succeeded|aborted|canceled): (.*)", run.output)
    results = [(sent, sent.result.result()) for sent in run.sent if sent.result is not None]
    assert len(lines) == len(run.sent) == GOALS
    reasons = [text for what, text in lines if what == "rejected"]
    assert len(reasons) == GOALS - len(results)
    assert all("; accepted: " in reason for reason in reasons)
    codes = {SUCCEEDED: {0}, CANCELED: {0}, ABORTED: {-1, -4, -5}}
    for sent, ended in results:
        assert ended.result.error_code in codes[ended.status], sent
        assert ended.result.error_string, sent
        if sent.expected == "aborted":
            assert (ended.status, ended.result.error_code) == (ABORTED, -1), sent
            assert "accepted: " in ended.result.error_string, sent
    named = {SUCCEEDED: "succeeded", CANCELED: "canceled", ABORTED: "aborted"}
    told = Counter((named[ended.status], ended.result.error_string) for _, ended in results)
    assert told == Counter(line for line in lines if line[0] != "rejected")
    # Each end and each kind of damage is there.
    ends = Counter(line[0] for line in lines)
    assert min(ends["rejected"], ends["succeeded"], ends["aborted"], ends["canceled"]) > 0.02 * GOALS, ends
    assert len({sent.wrong for sent in run.sent}) == 17


def test_no_set_point_jumps_or_leaves_the_limits(run: Run, limits: Any) -> None:
    """Over all goals and ends, at each tick: positions within limits, second differences within the accelerations."""
    assert (np.diff(run.stamps) == 10**6).all()
    assert (run.position >= limits.lower).all()
    assert (run.position <= limits.upper).all()
    assert fastest(run.position, run.velocity, limits) <= 1.0 + 1e-3
    # They were followed, not merely held: a tenth of the ticks moves, and some come near to the limit.
    assert (np.abs(run.velocity).max(axis=1) > 1e-3).mean() > 0.1
    assert fastest(run.position, run.velocity, limits) > 0.9


def fastest(position: NDArray[np.float64], velocity: NDArray[np.float64], limits: Any) -> float:
    """Return the largest acceleration that set-points show, as a share of the limit.

    By second differences of positions, and by differences of velocities.
    """
    shown = (
        np.abs(np.diff(position, 2, axis=0)).max(axis=0) / 1e-6,
        np.abs(np.diff(velocity, axis=0)).max(axis=0) / 1e-3,
    )
    return float((np.maximum(*shown) / limits.acceleration).max())
