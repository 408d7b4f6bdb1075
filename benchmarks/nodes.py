"""How fast the nodes are: in lock-step against a bare ping-pong, in one process, and as in `make demo`, recorded.

    python -m benchmarks.nodes lockstep|composition|speed|own_controller [--rounds 9] [--real-time]

lockstep: simulation and controller in two processes, not paced, in turns with a bare ping-pong of their messages, so
that whatever else the machine does meets both; and the rate of free-running time. composition: both nodes in one
process, alone, and with everything recorded by another one. speed: simulation, controller, line and recorder in four
processes, with the processor time and the wake-ups of each part; not paced, or with --real-time. Processor time is what
the system counts for each thread; it says less about what else the machine does than wall time does.
own_controller: a Python effort controller at 1 kHz, over DDS with plain
rclpy and in one process with the arm, in turns with the four processes. Each recorded run is compared with the closed
loop without ROS, message by message: none may be missing, no bit may differ.
"""

from __future__ import annotations

import re
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.effort_client import Hold
from benchmarks.ping_pong import ping_pong
from benchmarks.report import arguments, prepare_ros, print_table, publish, spread
from rx90_common.bags.comparison import Verdict, compare_bags
from rx90_common.bags.summary import summarise
from rx90_common.bags.tables import comparison_text
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.own_controller import run_controller
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup

BASE_HZ = Rates().base_hz
RECORDED = 10.0  # s; longer than the task takes
START = 0.25  # s
WINDOW = (0.2, 0.9)  # part of a recorded run in which processor time is counted
_TIMEOUT = 60.0
_SWITCHES = re.compile(r"^voluntary_ctxt_switches:\s*(\d+)", re.MULTILINE)
_PARTS = {
    "dds.udp": "middleware, receiving",
    "dds.ev": "middleware, timers",
    "dds.shm": "middleware, receiving",
}


class Work(NamedTuple):
    """What a part of a process did: processor time, s, and how often it went to sleep and was woken."""

    seconds: float
    switches: int


WorkOfParts = dict[tuple[str, str], Work]
"""By process and part."""


class Run(NamedTuple):
    """One recorded run.

    Attributes:
        factor: simulated time per wall time.
        ticks: in which work was counted.
        messages: recorded in a tick.
        work: of each process and part.
    """

    factor: float
    ticks: float
    messages: float
    work: WorkOfParts

    def microseconds(self, process: str) -> float:
        """Return the processor time of a process in a tick, us."""
        return (
            sum(work.seconds for (owner, _), work in self.work.items() if owner == process)
            / self.ticks
            * 1e6
        )


def _start(group: ProcessGroup, name: str, *parameters: str, node: str = "") -> ChildProcess:
    words = [word for parameter in parameters for word in ("-p", node + parameter)]
    return group.start(name, executable(name, "--ros-args", *words))


def _watch(
    done: Callable[[float], bool],
    look: Callable[[float], None] = lambda _now: None,
    release: bool = False,
) -> float:
    """Follow simulated time until `done`, and show it to `look`; return simulated time per wall time.

    Args:
        done: asked with the simulated time, s.
        look: called with each new simulated time, s.
        release: let a paused simulation run.
    """
    from rx90_sim.node.simulation_client import SimulationClient  # after `prepare_ros`

    stamps: list[tuple[float, float]] = []
    with client_node("benchmark", _TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        if release:
            simulation.pause(False)
        heard = time.monotonic()
        while not done(stamps[-1][1] if stamps else 0.0):
            client.spin()
            if not stamps or simulation.time > stamps[-1][1]:
                stamps.append((time.perf_counter(), simulation.time))
                heard = time.monotonic()
                look(simulation.time)
            if time.monotonic() > heard + _TIMEOUT:
                raise ExchangeError(f"no /clock within {_TIMEOUT:g} s; accepted: nodes that run")
    if len(stamps) < 3:
        raise ExchangeError(
            f"{len(stamps)} messages on /clock; accepted: a run that is heard from its begin on"
        )
    tail = stamps[len(stamps) // 10 :]  # in the beginning the graph is still being discovered
    return (tail[-1][1] - tail[0][1]) / (tail[-1][0] - tail[0][0])


def lockstep(rounds: int) -> dict[str, float]:
    """Return the figures of two processes for out/bench.json.

    Raises:
        ExchangeError: if a node does not start.
    """
    bare, channel, nodes = [], [], []
    for _ in range(rounds):
        pair = ping_pong(exchanges=6000, rounds=1)
        bare.append(pair[0])
        channel.append(pair[1])
        with ProcessGroup() as group:
            _start(group, "rx90_controller")
            # Paused until its client is connected: an unpaced run may be over before the graph has got to know that.
            run = ("duration:=5.0", "real_time_factor:=0.0", "clock_rate:=10", "paused:=true")
            simulation = _start(group, "rx90_sim", *run)
            factor = _watch(
                lambda _now, process=simulation: process.returncode is not None, release=True
            )  # type: ignore[misc]
            nodes.append(BASE_HZ * factor)
    with ProcessGroup() as group:
        _start(group, "rx90_controller")
        _start(group, "rx90_sim", "time_mode:=free_running")
        free = BASE_HZ * _watch(lambda now: now > 20.0)
    return {
        "ping_pong_exchanges_per_s": statistics.median(bare),
        "channel_ping_pong_exchanges_per_s": statistics.median(channel),
        "lockstep_ticks_per_s": statistics.median(nodes),
        "lockstep_vs_ping_pong": statistics.median(n / b for n, b in zip(nodes, bare, strict=True)),
        "lockstep_vs_channel_ping_pong": statistics.median(
            n / b for n, b in zip(nodes, channel, strict=True)
        ),
        "free_running_rate_hz": free,
        **spread("lockstep_real_time_factor", [ticks / BASE_HZ for ticks in nodes]),
    }


class Recording:
    """Runs along the line of the shipped task with every topic recorded, and the closed loop that they must equal."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._task = RobotFiles().required("task")
        setup = Setup.load()
        plan = plan_line(setup, load_task(self._task))
        run = simulate(setup, plan.points, duration=RECORDED, start_time=START, record_fast=True)
        write_bag(run, folder / "closed_loop")
        pose = ", ".join(repr(float(angle)) for angle in plan.start_pose)
        self._parameters = (f"duration:={RECORDED}", "paused:=true", f"initial_position:=[{pose}]")

    def run(self, number: int, *, one_process: bool, pace: float = 0.0) -> Run:
        """Record one run, at `pace` times real time or, with 0, as fast as it goes.

        Raises:
            Rx90Error: if a process fails, a message is missing or a bit differs.
        """
        bag, parameters = (
            self._folder / f"recorded_{number}",
            (*self._parameters, f"real_time_factor:={pace}"),
        )
        with ProcessGroup() as group:
            recorder = group.start("recorder", executable("rx90 bag", "record", "--output", bag))
            if one_process:
                cell = _start(group, "rx90_cell", *parameters, "clock_rate:=10", node="rx90_sim:")
                processes = {"simulation": cell}
            else:
                processes = {"simulation": _start(group, "rx90_sim", *parameters)}
                processes["controller"] = _start(group, "rx90_controller")
            processes["recorder"] = recorder
            line = group.start("line", executable("rx90 line", self._task, "--start-time", START))
            recorder.wait_for("ready: all")
            line.expect_success()
            seen: list[tuple[float, float, WorkOfParts]] = []

            def look(now: float) -> None:
                if len(seen) < len(WINDOW) and now >= WINDOW[len(seen)] * RECORDED:
                    seen.append((time.perf_counter(), now, _work(processes)))

            simulation = processes["simulation"]
            whole = _watch(lambda _now: simulation.returncode is not None, look, release=True)
            simulation.expect_success()
            recorder.signal(signal.SIGINT)
            recorder.expect_success()
        comparison = compare_bags(bag, self._folder / "closed_loop")
        if comparison.verdict is not Verdict.SAME:
            raise ExchangeError(
                f"the recorded run is not the closed loop's:\n{comparison_text(comparison)}"
            )
        (began, first, before), (ended, last, after) = seen
        work = {
            part: Work(done.seconds - before[part].seconds, done.switches - before[part].switches)
            for part, done in after.items()
            if part in before
        }
        factor = whole if one_process else (last - first) / (ended - began)
        return Run(
            factor, (last - first) * BASE_HZ, summarise(bag).count / (RECORDED * BASE_HZ), work
        )


def _work(processes: Mapping[str, ChildProcess]) -> WorkOfParts:
    """Return what the threads of each process have done so far, by part."""
    done: WorkOfParts = {}
    for name, process in processes.items():
        for thread in Path(f"/proc/{process.pid}/task").iterdir():
            kind = (thread / "comm").read_text().strip()
            part = _PARTS.get(kind.rpartition(".")[0], "Python and compiled code")
            seconds = int((thread / "schedstat").read_text().split()[0]) * 1e-9
            found = _SWITCHES.search((thread / "status").read_text())
            before = done.get((name, part), Work(0.0, 0))
            done[name, part] = Work(
                before.seconds + seconds, before.switches + int(found[1] if found else 0)
            )
    return done


def composition(rounds: int) -> dict[str, float]:
    """Return the figures of one process for out/bench.json."""
    alone, recorded = [], []
    with tempfile.TemporaryDirectory() as folder:
        recording = Recording(Path(folder))
        for number in range(rounds):
            with ProcessGroup() as group:
                parameters = (
                    "duration:=20.0",
                    "real_time_factor:=0.0",
                    "clock_rate:=10",
                    "paused:=true",
                )
                cell = _start(group, "rx90_cell", *parameters, node="rx90_sim:")
                alone.append(
                    _watch(lambda _now, cell=cell: cell.returncode is not None, release=True)
                )  # type: ignore[misc]
                cell.expect_success()
            recorded.append(recording.run(number, one_process=True).factor)
    return spread("composed_real_time_factor", alone) | spread(
        "composed_recorded_real_time_factor", recorded
    )


def speed(rounds: int, pace: float = 0.0) -> dict[str, float]:
    """Print the table of the parts, and return the figures of four processes for out/bench.json."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Recording(Path(folder))
        runs = [recording.run(number, one_process=False, pace=pace) for number in range(rounds)]
    headers = ("process", "part", "us in a tick", "wake-ups in a tick", "us in a recorded message")
    print_table(headers, parts(runs))
    figures = spread("demo_real_time_factor", [run.factor for run in runs])
    figures |= spread(
        "recorder_cpu_us_per_message", [run.microseconds("recorder") / run.messages for run in runs]
    )
    for process in ("simulation", "controller", "recorder"):
        figures[f"{process}_cpu_us_per_tick"] = statistics.median(
            run.microseconds(process) for run in runs
        )
    return figures


def own_controller(rounds: int) -> dict[str, float]:
    """Return the figures of a controller of one's own for out/bench.json.

    Raises:
        Rx90Error: if a process fails.
    """
    setup, nodes, alone, demo = Setup.load(), [], [], []
    run_controller(setup, Hold(), 0.1)  # compiles
    with tempfile.TemporaryDirectory() as folder:
        recording = Recording(Path(folder))
        for number in range(rounds):
            with ProcessGroup() as group:
                group.start("client", [sys.executable, "-m", "benchmarks.effort_client"])
                run = (
                    "duration:=10.0",
                    "real_time_factor:=0.0",
                    "paused:=true",
                    "command_interface:=joint",
                )
                simulation = _start(group, "rx90_sim", *run)
                nodes.append(
                    _watch(
                        lambda _now, process=simulation: process.returncode is not None,
                        release=True,
                    )
                )  # type: ignore[misc]
                simulation.expect_success()
            began = time.perf_counter()
            run_controller(setup, Hold(), RECORDED)
            alone.append(RECORDED / (time.perf_counter() - began))
            demo.append(recording.run(number, one_process=False).factor)
    return {
        **spread("own_controller_real_time_factor", nodes),
        **spread("own_controller_in_process_real_time_factor", alone),
        "own_controller_vs_demo": statistics.median(
            n / d for n, d in zip(nodes, demo, strict=True)
        ),
        "own_controller_in_process_vs_demo": statistics.median(
            a / d for a, d in zip(alone, demo, strict=True)
        ),
    }


def parts(runs: Sequence[Run]) -> list[tuple[str, ...]]:
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
    """Measure what is asked for, print the figures and merge them; those at real time are printed alone."""
    measures = {
        "speed": speed,
        "lockstep": lockstep,
        "composition": composition,
        "own_controller": own_controller,
    }
    options = arguments(
        __doc__,
        ("what", tuple(measures), "which arrangement"),
        ("--rounds", 9, "runs of each kind"),
        ("--real-time", False, "pace the four processes"),
    )
    prepare_ros()
    if options.real_time:
        speed(options.rounds, 1.0)
    else:
        publish(measures[options.what](options.rounds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
