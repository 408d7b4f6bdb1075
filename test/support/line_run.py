"""A short line through the nodes in lock-step, beside the same line through the closed loop without ROS."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from pathlib import Path

from processes import Processes
from ros_client import Client

from rx90_common.bags.comparison import BagComparison, Scope, compare_bags
from rx90_common.process.children import executable
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup

START = 0.1
TASK = """
line:
  provenance: assumed
  source: a short line for the tests
  start: [0.6, -0.03, 0.2]
  end: [0.6, 0.03, 0.2]
  speed: 0.2
  acceleration: 2.0
  tool_rpy_degrees: [0.0, 180.0, 0.0]
  rest_before: 0.1
  rest_after: 0.1
"""


def run_both_ways(
    processes: Processes, client: Client, setup: Setup, folder: Path, around: Sequence[str] = ("/usr/bin/env",)
) -> BagComparison:
    """Run the line both ways and compare all that was recorded, bit by bit.

    `around` is the command line before those of the simulation and the controller.
    """
    file = folder / "task.yaml"
    file.write_text(TASK, encoding="utf-8")
    task = load_task(file)
    write_bag(run_line(setup, task, start_time=START, record_fast=True), folder / "closed_loop")
    plan = plan_line(setup.robot, task)
    recorder = processes.start("rx90_bag", "record", "--output", folder / "recorded")
    simulation = processes.start(
        *around,
        *executable("rx90_sim"),
        "--ros-args",
        *("-p", f"initial_position:=[{', '.join(repr(float(q)) for q in plan.start_pose)}]"),
        *("-p", f"duration:={START + plan.duration!r}", "-p", "real_time_factor:=0.0", "-p", "paused:=true"),
    )
    processes.start(*around, *executable("rx90_controller"))
    line = processes.start("rx90_line", "--from-file", file, "--start-time", START)
    recorder.wait_for("ready: all")
    assert line.wait() == 0
    client.simulation.pause(False)
    assert simulation.wait() == 0
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0
    return compare_bags(folder / "recorded", folder / "closed_loop", scope=Scope(same_range=True))
