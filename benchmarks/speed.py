"""Four processes, not paced, everything recorded: speed, and the processor time and wake-ups of each part.

Simulation, controller, line and recorder run as in `make demo`. Each recorded run is compared with the closed loop
without ROS: no message may be missing, no bit may differ. Processor time is what the system counts for each thread; it
says less about what else the machine does than wall time does. docs/explanation/speed.md explains the table.
"""

from __future__ import annotations

import os
import re
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from benchmarks.composition import check
from benchmarks.report import merge, print_table, spread
from rx90_common.bags.summary import summarise
from rx90_common.base.rates import Rates
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
SIMULATED = 10.0  # s; longer than the task takes
START = 0.25  # s
WINDOW = (0.2, 0.9)  # part of the run in which processor time is counted
_TIMEOUT = 60.0
_SWITCHES = re.compile(r"^voluntary_ctxt_switches:\s*(\d+)", re.MULTILINE)
_PARTS = {"dds.udp": "middleware, receiving", "dds.ev": "middleware, timers", "dds.shm": "middleware, receiving"}


class Work(NamedTuple):
    """What a part of a process did: processor time, s, and how often it went to sleep and was woken."""

    seconds: float
    switches: int


class Run(NamedTuple):
    """One run.

    Attributes:
        factor: simulated time per wall time.
        ticks: in which work was counted.
        messages: recorded in a tick.
        work: by process and part.
    """

    factor: float
    ticks: float
    messages: float
    work: dict[tuple[str, str], Work]


def measure(rounds: int = ROUNDS) -> tuple[dict[str, float], list[Run]]:
    """Return the figures for out/bench.json, and the runs.

    Raises:
        Rx90Error: if a process fails, a message is missing or a bit differs.
    """
    setup, task = Setup.load(), RobotFiles().required("task")
    plan = plan_line(setup, load_task(task))
    runs = []
    with tempfile.TemporaryDirectory() as name:
        closed_loop = Path(name) / "closed_loop"
        write_bag(simulate(setup, plan.points, duration=SIMULATED, start_time=START, record_fast=True), closed_loop)
        for k in range(rounds):
            bag = Path(name) / f"recorded_{k}"
            runs.append(_run(task, plan, bag))
            check(bag, closed_loop)
    recorder = [_microseconds(run, "recorder") / run.messages for run in runs]
    figures = spread("demo_real_time_factor", [run.factor for run in runs])
    figures |= spread("recorder_cpu_us_per_message", recorder)
    for process in ("simulation", "controller", "recorder"):
        figures[f"{process}_cpu_us_per_tick"] = statistics.median(_microseconds(run, process) for run in runs)
    return figures, runs


def _microseconds(run: Run, process: str) -> float:
    """Return the processor time of a process in a tick, us."""
    return sum(work.seconds for (owner, _), work in run.work.items() if owner == process) / run.ticks * 1e6


def _run(task: Path, plan: LinePlan, bag: Path) -> Run:
    pose = ", ".join(repr(float(angle)) for angle in plan.start_pose)
    given = (f"duration:={SIMULATED}", "real_time_factor:=0.0", "paused:=true", f"initial_position:=[{pose}]")
    with ProcessGroup() as group:
        recorder = group.start("recorder", executable("rx90_bag", "record", "--output", bag))
        words = [word for parameter in given for word in ("-p", parameter)]
        simulation = group.start("simulation", executable("rx90_sim", "--ros-args", *words))
        controller = group.start("controller", executable("rx90_controller"))
        line = group.start("line", executable("rx90_line", "--from-file", task, "--start-time", START))
        recorder.wait_for("ready: all")
        line.expect_success()
        processes = {"simulation": simulation, "controller": controller, "recorder": recorder}
        factor, ticks, work = _watch(processes)
        simulation.expect_success()
        recorder.signal(signal.SIGINT)
        recorder.expect_success()
    return Run(factor, ticks, summarise(bag).count / (SIMULATED * Rates().base_hz), work)


def _watch(processes: Mapping[str, ChildProcess]) -> tuple[float, float, dict[tuple[str, str], Work]]:
    """Let time run to its end; return speed, and ticks and work within the window."""
    from rx90_sim.node.simulation_client import SimulationClient  # after `prepare`

    seen: list[tuple[float, float, dict[tuple[str, str], Work]]] = []
    with client_node("benchmark", _TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        simulation.pause(False)
        while processes["simulation"].returncode is None:
            client.spin()
            if len(seen) < len(WINDOW) and simulation.time >= WINDOW[len(seen)] * SIMULATED:
                seen.append((time.perf_counter(), simulation.time, _work(processes)))
    (began, first, before), (ended, last, after) = seen
    work = {
        part: Work(done.seconds - before[part].seconds, done.switches - before[part].switches)
        for part, done in after.items()
        if part in before
    }
    return (last - first) / (ended - began), (last - first) * Rates().base_hz, work


def _work(processes: Mapping[str, ChildProcess]) -> dict[tuple[str, str], Work]:
    """Return what the threads of each process have done so far, by part."""
    done: dict[tuple[str, str], Work] = {}
    for name, process in processes.items():
        for thread in Path(f"/proc/{process.pid}/task").iterdir():
            kind = (thread / "comm").read_text().strip()
            part = _PARTS.get(kind.rpartition(".")[0], "Python and compiled code")
            seconds = int((thread / "schedstat").read_text().split()[0]) * 1e-9
            found = _SWITCHES.search((thread / "status").read_text())
            before = done.get((name, part), Work(0.0, 0))
            done[name, part] = Work(before.seconds + seconds, before.switches + int(found[1] if found else 0))
    return done


def table(runs: list[Run]) -> list[tuple[str, ...]]:
    """Return the medians over the runs: process, part, us and wake-ups in a tick, us in a recorded message."""
    rows = []
    for process, part in runs[0].work:
        there = [(run, run.work[process, part]) for run in runs if (process, part) in run.work]
        in_tick = statistics.median(work.seconds / run.ticks * 1e6 for run, work in there)
        woken = statistics.median(work.switches / run.ticks for run, work in there)
        in_message = in_tick / statistics.median(run.messages for run, _ in there)
        rows.append((process, part, f"{in_tick:.1f}", f"{woken:.2f}", f"{in_message:.1f}"))
    return rows


def main() -> int:
    """Print the figures and merge them."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    prepare()
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    figures, runs = measure(rounds)
    headers = ("process", "part", "us in a tick", "wake-ups in a tick", "us in a recorded message")
    print_table(headers, table(runs))
    print_table(("figure", "value"), [(key, f"{value:.2f}") for key, value in figures.items()])
    merge(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
