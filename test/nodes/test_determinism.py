"""The run over DDS and the closed loop without ROS are the same numbers."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from processes import Processes
from ros_client import Client

from rx90_bag.comparison import Scope, Verdict, compare_bags
from rx90_bag.comparison_report import as_text
from rx90_bag.tolerance import Tolerances
from rx90_controller.line import plan_line
from rx90_controller.line_task import load_task
from rx90_loop.run_bag import write_run
from rx90_loop.setup import Setup
from rx90_loop.task_run import run_task

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


@pytest.mark.ros
def test_lockstep_gives_the_closed_loops_bits_on_a_loaded_machine(
    processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """With both cores busy, every recorded number equals the closed loop without ROS, to the last bit."""
    file = tmp_path / "task.yaml"
    file.write_text(TASK, encoding="utf-8")
    task = load_task(file)
    write_run(run_task(shipped, task, start_time=START, record_fast=True), tmp_path / "closed_loop")
    plan = plan_line(shipped.robot, task)
    for _ in range(2):
        processes.start(sys.executable, "-c", "while True: pass")
    recorder = processes.start("rx90_bag", "record", "--output", tmp_path / "recorded")
    simulation = processes.start(
        "rx90_sim",
        "--ros-args",
        *("-p", f"initial_position:=[{', '.join(repr(float(q)) for q in plan.start_pose)}]"),
        *("-p", f"duration:={START + plan.duration!r}", "-p", "real_time_factor:=0.0", "-p", "paused:=true"),
    )
    processes.start("rx90_controller")
    line = processes.start("rx90_line", "--from-file", file, "--start-time", START)
    recorder.wait_for("ready: all")
    assert line.wait() == 0
    assert client.call("rx90_sim/pause", data=False).success
    assert simulation.wait() == 0
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0
    comparison = compare_bags(tmp_path / "recorded", tmp_path / "closed_loop", Tolerances(), Scope(same_range=True))
    assert comparison.verdict is Verdict.SAME, as_text(comparison)
    assert {topic.topic for topic in comparison.topics} == {
        "/friction_states",
        "/joint_states",
        "/motor_commands",
        "/motor_states",
        "/rx90_controller/reference",
        "/rx90_controller/tracking_error",
    }
