"""Both nodes in one process: the numbers, names and manners that they have in two."""

from __future__ import annotations

import signal
from itertools import pairwise
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from line_run import TOPICS, run_both_ways
from processes import Processes
from ros_client import Client, seconds

from rx90_common.bags.comparison import Verdict
from rx90_common.bags.tables import comparison_text
from rx90_emulator.loop.setup import Setup

IN_CELL_1 = ("--ros-args", "-r", "__ns:=/cell_1")


@pytest.mark.ros
def test_one_process_gives_the_closed_loops_bits(
    processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """With a parameter file for both, every recorded number equals the closed loop without ROS, to the last bit."""
    comparison = run_both_ways(processes, client, shipped, tmp_path, composed=True)
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
    assert {topic.topic for topic in comparison.topics} == TOPICS


@pytest.mark.ros
def test_services_deaths_and_the_end_are_those_of_two_processes(processes: Processes) -> None:
    """In a namespace both nodes are asked and heard as ever; kill -9 leaves nothing behind, and Ctrl-C ends with 0."""
    client = Client("/cell_1")
    try:
        cell = processes.start(
            "rx90_cell", *IN_CELL_1, *("-p", "rx90_sim:paused:=true", "-p", "rx90_sim:step_ticks:=8")
        )
        states, commands = client.listen("motor_states"), client.listen("motor_commands")
        diagnostics = client.listen("/diagnostics", DiagnosticArray)
        for _ in range(2):
            client.simulation.step()
        client.spin_until(lambda: len(states) == len(commands) == 16, "16 ticks")
        for heard in (states, commands):
            assert [seconds(message) for message in heard] == pytest.approx([k * 250e-6 for k in range(16)])
        second = processes.run("rx90_sim", *IN_CELL_1)
        assert (second.returncode, f"process {cell.pid};" in second.stderr) == (3, True)
        client.spin_until(lambda: len({m.status[0].name for m in diagnostics}) == 2, "diagnostics of both nodes")
        cell.signal(signal.SIGKILL)

        cell = processes.start("rx90_cell", *IN_CELL_1, "-p", "rx90_sim:real_time_factor:=0.1")
        joints = client.listen("joint_states")
        client.spin_until(lambda: len(joints) > 10, "time to run again")
        client.enable(False)
        client.spin_until(lambda: len(commands[-1].effort) == 0, "commands without torque")
        client.simulation.reset()
        client.spin_until(lambda: any(seconds(b) < seconds(a) for a, b in pairwise(joints)), "time to go back")
        cell.signal(signal.SIGINT)
        assert cell.wait() == 0
        assert "Traceback" not in cell.output
    finally:
        client.close()


@pytest.mark.ros
def test_free_running_time_in_one_process(processes: Processes, client: Client) -> None:
    """By the wall clock the brakes open and a motion comes to its end; SIGTERM ends with 0."""
    cell = processes.start("rx90_cell", "--ros-args", "-p", "rx90_sim:time_mode:=free_running")
    reference = client.listen("rx90_controller/reference", depth=1)
    cell.wait_for("the brakes open")
    client.send([(0.3, [0.02] * 6)])
    end = pytest.approx([0.02] * 6, abs=1e-12)
    client.spin_until(lambda: bool(reference) and list(reference[-1].position) == end, "the end of the motion")
    cell.signal(signal.SIGTERM)
    assert cell.wait() == 0
    assert "Traceback" not in cell.output


@pytest.mark.ros
def test_other_rates_in_the_other_section_end_it(processes: Processes) -> None:
    """Rates that differ between the two nodes are one line with both values."""
    done = processes.run("rx90_cell", "--ros-args", "-p", "rx90_controller:position_rate:=500")
    assert done.returncode == 3
    assert "rx90_cell: position_rate is 500 Hz here and 1000 Hz in the simulation" in done.stderr
