"""The lock-step of the nodes with somebody looking against that without; the memory of a long look.

    python -m benchmarks.view                  # simulation and controller with rx90_view, as fast as they go
    python -m benchmarks.view --memory 600     # s of live view in real time: memory of server and page

With and without take turns within one run of the nodes, so that whatever else the machine does meets both. A page in
Chromium draws in software where there is no graphics card, and takes the processors from the nodes: the page that only
listens to the server's web socket tells what the server and its listening cost.

A shared machine may be half as fast a few seconds later. A round counts only if the speeds before and after the look
differ by less than a tenth: what happens in between is not asked.
"""

from __future__ import annotations

import os
import shutil
import signal
import statistics
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import arguments, prepare_ros, publish
from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_common.process.interrupts import terminations_as_interrupts

ROUNDS = 9
WINDOW = 3.0  # s of wall time
_STEADY = 0.1  # largest difference of the speeds before and after a look, as a share of their mean
_TRIES = 5  # as many rounds as shall count, at most
_TIMEOUT = 60.0
_SAMPLES = 40  # of the memory
_SETTLED = 0.3  # share of a long look in which caches fill
_FLAGS = (
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --ignore-gpu-blocklist --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
)
_DRAWN = "() => Boolean(window.__viserMutable?.scene)"


class Pace:
    """Simulated time against wall time, heard on /clock by a thread of its own.

    Args:
        nodes: processes whose processor time is counted.
    """

    def __init__(self, nodes: Sequence[ChildProcess]) -> None:
        self._nodes = nodes
        self._now = (0.0, 0.0)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def window(self, seconds: float = WINDOW) -> tuple[float, float]:
        """Return simulated s per s of wall time, and s of the nodes' processor time per simulated s, from now on.

        Raises:
            ExchangeError: if time stands still.
        """
        (wall, simulated), used = self._next(), self._used()
        time.sleep(seconds)
        (wall_after, simulated_after), used_after = self._next(), self._used()
        gone = simulated_after - simulated
        return gone / (wall_after - wall), (used_after - used) / gone

    def close(self) -> None:
        """Listen no more."""
        self._ended.set()
        self._thread.join()

    def _next(self) -> tuple[float, float]:
        before, deadline = self._now, time.monotonic() + _TIMEOUT
        while self._now == before:
            if time.monotonic() > deadline:
                raise ExchangeError(f"no /clock within {_TIMEOUT:g} s; accepted: nodes that run")
            time.sleep(0.001)
        return self._now

    def _listen(self) -> None:
        from rx90_sim.node.simulation_client import SimulationClient  # after `prepare_ros`

        with client_node("benchmark", _TIMEOUT, lambda _: None) as client:
            simulation = SimulationClient(client)
            while not self._ended.is_set():
                client.spin()
                if simulation.time != self._now[1]:
                    self._now = (time.perf_counter(), simulation.time)

    def _used(self) -> float:
        return sum(processor_time(node.pid) for node in self._nodes)


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used, s, finer than /proc, which counts ticks of the kernel."""
    return time.clock_gettime((~pid << 3) | 2)  # CPUCLOCK_SCHED of another process, as clock_getcpuclockid makes it


def memory(pid: int) -> float:
    """Return the resident memory of a process, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def viewer(*options: object) -> Iterator[tuple[ChildProcess, str]]:
    """Start rx90_view on a free port; give the process and the page's address, and end it afterwards."""
    with ProcessGroup() as group:
        process = group.start("view", executable("rx90_view", "--port", 0, "--no-browser", *options))
        yield process, process.wait_for(r"page: (\S+)")[1]
        process.signal(signal.SIGINT)
        process.expect_success()


@contextmanager
def socket_alone(address: str) -> Iterator[None]:
    """Take what the page is sent, and draw nothing."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None, compression=None) as connection:
        threading.Thread(target=lambda: all(True for _ in connection), daemon=True).start()
        yield


@contextmanager
def chromium(address: str) -> Iterator[Any]:
    """Have the page open in Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS.split())
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.wait_for_function(_DRAWN, timeout=2e3 * _TIMEOUT)
        yield page
        browser.close()


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the figures for out/bench.json: of the nodes with a viewer, against those around without one.

    Raises:
        ExchangeError: if the nodes do not run, or the machine is too restless for so many rounds.
    """
    looks: dict[str, Callable[[str], AbstractContextManager[Any]]] = {"socket": socket_alone, "page": chromium}
    figures: dict[str, float] = {}
    for arrangement, executables in (
        ("two_processes", ("rx90_sim", "rx90_controller")),
        ("one_process", ("rx90_cell",)),
    ):
        with ProcessGroup() as group:
            first, *others = executables
            nodes = [group.start(first, executable(first, "--ros-args", "-p", "rx90_sim:real_time_factor:=0.0"))]
            nodes += [group.start(name, executable(name)) for name in others]
            pace = Pace(nodes)
            try:
                pace.window()  # warm
                for name, look in looks.items():
                    speeds, costs = zip(*_steady_rounds(pace, look, rounds, f"{arrangement}, {name}"), strict=True)
                    figures[f"view_{name}_{arrangement}_speed"] = statistics.median(speeds)
                    figures[f"view_{name}_{arrangement}_processor_time"] = statistics.median(costs)
            finally:
                pace.close()
    return figures


def _steady_rounds(
    pace: Pace, look: Callable[[str], AbstractContextManager[Any]], rounds: int, name: str
) -> list[tuple[float, float]]:
    """Return speed and processor time with a viewer, as shares of those without, of so many rounds that count."""
    counted: list[tuple[float, float]] = []
    for _ in range(_TRIES * rounds):
        speed, cost, unrest = _against(pace, look)
        steady = unrest <= _STEADY
        verdict = "" if steady else f", not counted: the speeds without differ by {unrest:.0%}"
        print(f"{name}: speed {speed:.3f}, processor time {cost:.3f}{verdict}", flush=True)
        if steady:
            counted.append((speed, cost))
        if len(counted) == rounds:
            return counted
    raise ExchangeError(
        f"{name}: {len(counted)} of {_TRIES * rounds} rounds were steady; accepted: {rounds}, on a quieter machine"
    )


def _against(pace: Pace, look: Callable[[str], AbstractContextManager[Any]]) -> tuple[float, float, float]:
    """Return speed and processor time with a viewer and a page, as shares of those without, and how these differ."""
    before = pace.window()
    with viewer() as (_, address), look(address):
        time.sleep(1.0)
        during = pace.window()
    after = pace.window()
    speed, cost = (2.0 * x / (a + b) for x, a, b in zip(during, before, after, strict=True))
    return speed, cost, 2.0 * abs(before[0] - after[0]) / (before[0] + after[0])


def watch_memory(seconds: float) -> dict[str, float]:
    """Return how memory grows in a live view of a moving arm, by a straight line, and what it comes to.

    The page's is that of its JavaScript heap after garbage has been collected.
    """
    rows = []
    with viewer("--demo") as (process, address), chromium(address) as page:
        session = page.context.new_cdp_session(page)
        began = time.monotonic()
        for k in range(_SAMPLES + 1):
            page.wait_for_timeout(max(0.0, began + k * seconds / _SAMPLES - time.monotonic()) * 1e3)
            session.send("HeapProfiler.collectGarbage")
            heap = session.send("Runtime.getHeapUsage")["usedSize"] / 1e6
            rows.append((time.monotonic() - began, memory(process.pid), heap))
            print("{:6.0f} s  server {:7.1f} MB  page {:6.2f} MB".format(*rows[-1]), flush=True)
    times, server, heap = np.array(rows).T
    late = times >= _SETTLED * seconds
    growth = [float(np.polyfit(times[late], values[late], 1)[0]) * 600.0 for values in (server, heap)]
    return {
        "view_memory_seconds": float(times[-1]),
        "view_server_memory_mb": float(server[-1]),
        "view_server_memory_growth_mb_in_10_min": growth[0],
        "view_page_heap_mb": float(heap[-1]),
        "view_page_heap_growth_mb_in_10_min": growth[1],
    }


def main() -> int:
    """Print the figures and merge them."""
    options = arguments(
        __doc__,
        ("--memory", 0.0, "s to look and watch the memory instead"),
        ("--rounds", ROUNDS, "turns with and without"),
    )
    prepare_ros()
    with terminations_as_interrupts():  # who is ended leaves no nodes behind
        figures = watch_memory(options.memory) if options.memory else measure(options.rounds)
    publish(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
