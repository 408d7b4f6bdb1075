"""Both nodes in one process, not paced: alone, and with everything recorded by another process.

Each recorded run is compared with the closed loop without ROS, message by message: none may be missing, no bit may
differ.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.lockstep import slope
from benchmarks.report import merge, print_table, spread
from rx90_common.bags.comparison import Verdict, compare_bags
from rx90_common.bags.tables import comparison_text
from rx90_common.base.errors import ExchangeError
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.client_node import client_node
from rx90_common.exchange.ros_start import prepare
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_controller.lines.plan import LinePlan
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup

ROUNDS = 9
SIMULATED = 20.0  # s
RECORDED = 10.0  # s; longer than the task takes
START = 0.25  # s
_TIMEOUT = 60.0


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the figures for out/bench.json.

    Raises:
        Rx90Error: if a process fails, a message is missing or a bit differs.
    """
    setup, task = Setup.load(), RobotFiles().required("task")
    plan = plan_line(setup, load_task(task))
    alone, recorded = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        closed_loop = folder / "closed_loop"
        write_bag(simulate(setup, plan.points, duration=RECORDED, start_time=START, record_fast=True), closed_loop)
        for k in range(rounds):
            alone.append(_alone(SIMULATED))
            recorded.append(_recorded(task, plan, folder / f"recorded_{k}"))
            check(folder / f"recorded_{k}", closed_loop)
    return spread("composed_real_time_factor", alone) | spread("composed_recorded_real_time_factor", recorded)


def _alone(duration: float) -> float:
    """Return simulated time per wall time of the process while nobody listens, but to some messages on /clock."""
    with ProcessGroup() as group:
        return _factor(_start_cell(group, duration))


def _recorded(task: Path, plan: LinePlan, bag: Path) -> float:
    """Return the same along the line of a task, with every topic recorded."""
    pose = ", ".join(repr(float(angle)) for angle in plan.start_pose)
    with ProcessGroup() as group:
        recorder = group.start("recorder", executable("rx90_bag", "record", "--output", bag))
        cell = _start_cell(group, RECORDED, f"initial_position:=[{pose}]")
        line = group.start("line", executable("rx90_line", "--from-file", task, "--start-time", START))
        recorder.wait_for("ready: all")
        line.expect_success()
        factor = _factor(cell)
        recorder.signal(signal.SIGINT)
        recorder.expect_success()
    return factor


def _start_cell(group: ProcessGroup, duration: float, *parameters: str) -> ChildProcess:
    given = (f"duration:={duration}", "real_time_factor:=0.0", "clock_rate:=10", "paused:=true", *parameters)
    words = [word for parameter in given for word in ("-p", f"rx90_sim:{parameter}")]
    return group.start("cell", executable("rx90_cell", "--ros-args", *words))


def _factor(cell: ChildProcess) -> float:
    """Let time run until the process ends; return simulated time per wall time."""
    from rx90_sim.node.simulation_client import SimulationClient  # after `prepare`

    stamps: list[tuple[float, float]] = []
    with client_node("benchmark", _TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        simulation.pause(False)
        while cell.returncode is None:
            client.spin()
            if not stamps or simulation.time > stamps[-1][1]:
                stamps.append((time.perf_counter(), simulation.time))
    cell.expect_success()
    return slope(stamps)


def check(bag: Path, closed_loop: Path) -> None:
    """Compare a recorded bag with that of the closed loop without ROS.

    Raises:
        ExchangeError: if a message is missing or a bit differs.
    """
    comparison = compare_bags(bag, closed_loop)
    if comparison.verdict is not Verdict.SAME:
        raise ExchangeError(f"the recorded run is not the closed loop's:\n{comparison_text(comparison)}")


def main() -> int:
    """Print the figures and merge them."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    prepare()
    figures = measure()
    print_table(("figure", "value"), [(key, f"{value:.2f}") for key, value in figures.items()])
    merge(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
