"""Nodes of arms with another number of joints than six: the bits of the engine."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import Processes
from ros_client import Client, seconds

from benchmarks.any_arm import joint_names, write_arm
from rx90_common.bags.comparison import Verdict, compare_bags
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.result import MotionCommand, write_bag
from rx90_emulator.loop.setup import load_setup

DURATION = 0.3  # s


def by_stamp(heard: list[Any]) -> dict[float, Any]:
    """Return messages by their stamps, s."""
    return {seconds(message): message for message in heard}


@pytest.mark.ros
@pytest.mark.parametrize(
    ("joints", "nodes"),
    [pytest.param(1, ("rx90_sim", "rx90_controller"), id="1-apart"), pytest.param(7, ("rx90_cell",), id="7-composed")],
)
def test_nodes_give_the_engines_bits(
    processes: Processes, client: Client, tmp_path: Path, joints: int, nodes: tuple[str, ...]
) -> None:
    """In lock-step all states of a short motion, as heard and as recorded, are those of the loop without ROS."""
    coupling = None
    if joints > 1:
        turns = np.eye(joints)
        turns[-1, -2] = -1.0
        coupling = turns.tolist()
    folder = write_arm(tmp_path / "arm", joints, coupling)
    # The engine first, which leaves its compiled code to the nodes.
    setup, goal = load_setup(robot=folder), np.full((1, joints), 0.05)
    points = TrajectoryPoints(np.array([0.25]), goal, np.zeros((1, joints)), None)
    run = simulate_commands(setup, (MotionCommand(0, points),), np.zeros(joints), DURATION, record_fast=True)
    write_bag(run, tmp_path / "engine")
    slow, given = run.slow, ["-p", f"robot:={folder}"]
    for name, value in (("paused", "true"), ("duration", DURATION), ("real_time_factor", 0.0)):
        given += ["-p", f"rx90_sim:{name}:={value}"]
    simulation, *others = [processes.start(name, "--ros-args", *given) for name in nodes]
    states, friction = client.listen("joint_states"), client.listen("friction_states")
    simulation.wait_for("]: ready: ")
    recorder = processes.start("rx90 bag", "record", "--output", tmp_path / "nodes")
    recorder.wait_for("ready: all")
    client.send([(0.25, goal[0].tolist())], joint_names(joints))
    client.known_to("rx90_sim")
    client.simulation.pause(False)
    count = round(DURATION * 1000)
    # While time stands still, the newest sample comes again.
    client.spin_until(lambda: len(by_stamp(states)) == len(by_stamp(friction)) == count, "all states")
    assert simulation.wait() == 0
    for process in (*others, recorder):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output
    compared = compare_bags(tmp_path / "nodes", tmp_path / "engine")
    assert {topic.topic for topic in compared.topics} >= {"/joint_states", "/motor_commands", "/motor_states"}
    assert compared.verdict is Verdict.SAME
    for heard, names, rows in (
        (states, setup.robot.joint_names, slow.joint_states),
        (friction, setup.friction.names, slow.friction_states),
    ):
        assert tuple(heard[0].name) == names
        samples = by_stamp(heard).values()
        got = np.array([[message.position, message.velocity, message.effort] for message in samples])
        assert got.tobytes() == rows.tobytes()
    assert np.abs(slow.joint_states[-1, 0] - 0.05).max() < 1e-3
