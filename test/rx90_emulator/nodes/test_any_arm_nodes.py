"""Nodes of arms with another number of joints than six: the bits of the engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import Processes
from ros_client import Client, seconds

from benchmarks.any_arm import joint_names, write_arm
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.result import MotionCommand
from rx90_emulator.loop.setup import load_setup

DURATION = 0.3  # s


def by_stamp(heard: list[Any]) -> dict[float, Any]:
    """Return messages by their stamps, s."""
    return {seconds(message): message for message in heard}


@pytest.mark.ros
@pytest.mark.parametrize("joints", [1, 7])
def test_nodes_give_the_engines_bits(processes: Processes, client: Client, tmp_path: Path, joints: int) -> None:
    """In lock-step all states of a short motion, as heard, are those of the loop without ROS."""
    coupling = None
    if joints > 1:
        turns = np.eye(joints)
        turns[-1, -2] = -1.0
        coupling = turns.tolist()
    folder = write_arm(tmp_path / "arm", joints, coupling)
    # The engine first, which leaves its compiled code to the nodes.
    setup, goal = load_setup(robot=folder), np.full((1, joints), 0.05)
    points = TrajectoryPoints(np.array([0.25]), goal, np.zeros((1, joints)), None)
    slow = simulate_commands(setup, (MotionCommand(0, points),), np.zeros(joints), DURATION).slow
    given = ["-p", f"robot:={folder}"]
    for name, value in (("paused", "true"), ("duration", DURATION), ("real_time_factor", 0.0)):
        given += ["-p", f"rx90_sim:{name}:={value}"]
    cell = processes.start("rx90_cell", "--ros-args", *given)
    states, friction = client.listen("joint_states"), client.listen("friction_states")
    cell.wait_for("]: ready: ")
    client.send([(0.25, goal[0].tolist())], joint_names(joints))
    client.known_to("rx90_sim")
    client.simulation.pause(False)
    count = round(DURATION * 1000)
    # While time stands still, the newest sample comes again.
    client.spin_until(lambda: len(by_stamp(states)) == len(by_stamp(friction)) == count, "all states")
    assert cell.wait() == 0
    for heard, names, rows in (
        (states, setup.robot.joint_names, slow.joint_states),
        (friction, setup.friction.names, slow.friction_states),
    ):
        assert tuple(heard[0].name) == names
        samples = by_stamp(heard).values()
        got = np.array([[message.position, message.velocity, message.effort] for message in samples])
        assert got.tobytes() == rows.tobytes()
    assert np.abs(slow.joint_states[-1, 0] - 0.05).max() < 1e-3
