"""The lock-step of the nodes with somebody looking against that without.

    python -m benchmarks.view                  # simulation and controller with rx90 view, as fast as they go

With and without take turns within one run of the nodes, so that whatever else the machine does meets both. Who looks
takes what the page is sent, and draws nothing: a browser without a graphics card would take the processors from the
nodes.

A shared machine may be half as fast a few seconds later. A round counts only if the speeds before and after the look
differ by less than a tenth: what happens in between is not asked.
"""

from __future__ import annotations

import signal
import statistics
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

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
    # CPUCLOCK_SCHED of another process, as clock_getcpuclockid makes it
    return time.clock_gettime((~pid << 3) | 2)


@contextmanager
def viewer() -> Iterator[str]:
    """Start rx90 view on a free port; give the page's address, and end it afterwards."""
    with ProcessGroup() as group:
        process = group.start("view", executable("rx90 view", "--port", 0, "--no-browser"))
        yield process.wait_for(r"page: (\S+)")[1]
        process.signal(signal.SIGINT)
        process.expect_success()


@contextmanager
def socket_alone(address: str) -> Iterator[None]:
    """Take what the page is sent, and draw nothing."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with connect(
        address.replace("http", "ws"), subprotocols=[protocol], max_size=None, compression=None
    ) as connection:
        threading.Thread(target=lambda: all(True for _ in connection), daemon=True).start()
        yield


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the figures for out/bench.json: of the nodes with a viewer, against those around without one.

    Raises:
        ExchangeError: if the nodes do not run, or the machine is too restless for so many rounds.
    """
    figures: dict[str, float] = {}
    for arrangement, executables in (
        ("two_processes", ("rx90_sim", "rx90_controller")),
        ("one_process", ("rx90_cell",)),
    ):
        with ProcessGroup() as group:
            first, *others = executables
            nodes = [
                group.start(
                    first, executable(first, "--ros-args", "-p", "rx90_sim:real_time_factor:=0.0")
                )
            ]
            nodes += [group.start(name, executable(name)) for name in others]
            pace = Pace(nodes)
            try:
                pace.window()  # warm
                speeds, costs = zip(*_steady_rounds(pace, rounds, arrangement), strict=True)
                figures[f"view_socket_{arrangement}_speed"] = statistics.median(speeds)
                figures[f"view_socket_{arrangement}_processor_time"] = statistics.median(costs)
            finally:
                pace.close()
    return figures


def _steady_rounds(pace: Pace, rounds: int, name: str) -> list[tuple[float, float]]:
    """Return speed and processor time with a viewer, as shares of those without, of so many rounds that count."""
    counted: list[tuple[float, float]] = []
    for _ in range(_TRIES * rounds):
        speed, cost, unrest = _against(pace)
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


def _against(pace: Pace) -> tuple[float, float, float]:
    """Return speed and processor time with a viewer and a page, as shares of those without, and how these differ."""
    before = pace.window()
    with viewer() as address, socket_alone(address):
        time.sleep(1.0)
        during = pace.window()
    after = pace.window()
    speed, cost = (2.0 * x / (a + b) for x, a, b in zip(during, before, after, strict=True))
    return speed, cost, 2.0 * abs(before[0] - after[0]) / (before[0] + after[0])


def main() -> int:
    """Print the figures and merge them."""
    options = arguments(__doc__, ("--rounds", ROUNDS, "turns with and without"))
    prepare_ros()
    with terminations_as_interrupts():  # who is ended leaves no nodes behind
        figures = measure(options.rounds)
    publish(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
