"""The nodes and clients that the tests of the action share."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from action_bench import PAUSED, UNPACED, Bench
from numpy.typing import NDArray
from processes import own_processes
from ros_client import Client

from rx90_emulator.loop.setup import Setup

# As it is written for joint_trajectory_controller, in whose place the node is.
ITS_FILE = """
rx90_controller:
  ros__parameters:
    joints: [joint_6, joint_1, joint_2, joint_3, joint_4, joint_5]
    command_interfaces: [position]
    state_interfaces: [position, velocity]
    state_publish_rate: 50.0
    action_monitor_rate: 20.0
    allow_partial_joints_goal: false
    interpolation_method: splines
    cmd_timeout: 0.0
    constraints: {stopped_velocity_tolerance: 0.01, goal_time: 0.0, joint_1: {trajectory: 0.0, goal: 0.0}}
    gains: {joint_1: {p: 1.0, i: 0.0, d: 0.0, i_clamp: 0.0, ff_velocity_scale: 1.0}}
"""


@pytest.fixture(scope="package")
def bench(needs_action: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:  # noqa: ARG001 - it must be there
    folder = tmp_path_factory.mktemp("action")
    (file := folder / "its_file.yaml").write_text(ITS_FILE, encoding="utf-8")
    with own_processes(folder) as processes:
        cell = processes.start("rx90_cell", "--ros-args", *PAUSED, *UNPACED, "--params-file", file)
        with closing(Client()) as client:
            yield Bench(client, cell, processes)


@pytest.fixture
def acceleration(shipped: Setup) -> NDArray[np.float64]:
    return shipped.controller.limits(shipped.robot).acceleration * (1.0 + 1e-9) + 1e-9
