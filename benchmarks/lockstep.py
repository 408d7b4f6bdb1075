"""The real nodes in lock-step against a bare ping-pong of their messages, and the rate of free-running time.

The simulation and controller nodes run as in `ros2 run`, unpaced. Bare ping-pong and nodes take turns, so that
whatever else the machine does meets both.
"""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from benchmarks.ping_pong import measure as measure_ping_pong
from benchmarks.report import merge, print_table, spread
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import Rates
from rx90_common.process.children import executable

ROUNDS = 9
SIMULATED = 5.0
FREE_SECONDS = 20.0
_TIMEOUT = 120.0


def measure(rounds: int = ROUNDS) -> dict[str, float]:
    """Return the figures for out/bench.json.

    Raises:
        ExchangeError: if a node does not start.
    """
    rates = Rates()
    bare, channel, nodes = [], [], []
    for _ in range(rounds):
        ping_pong = measure_ping_pong(exchanges=6000, rounds=1)
        bare.append(ping_pong.bare)
        channel.append(ping_pong.channel)
        nodes.append(_ticks_per_second(SIMULATED))
    return {
        "ping_pong_exchanges_per_s": statistics.median(bare),
        "channel_ping_pong_exchanges_per_s": statistics.median(channel),
        "lockstep_ticks_per_s": statistics.median(nodes),
        "lockstep_vs_ping_pong": statistics.median(n / b for n, b in zip(nodes, bare, strict=True)),
        "lockstep_vs_channel_ping_pong": statistics.median(n / b for n, b in zip(nodes, channel, strict=True)),
        "free_running_rate_hz": _free_running_rate(FREE_SECONDS),
        **spread("lockstep_real_time_factor", [ticks / rates.base_hz for ticks in nodes]),
    }


@contextmanager
def _node(name: str, *parameters: str) -> Iterator[subprocess.Popen[str]]:
    arguments = [word for parameter in parameters for word in ("-p", parameter)]
    process = subprocess.Popen(
        executable(name, "--ros-args", *arguments),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
        process.kill()


def _ticks_per_second(simulated: float) -> float:
    """Return the ticks per second of wall time between the first and the last message on /clock."""
    parameters = (f"duration:={simulated}", "real_time_factor:=0.0", "clock_rate:=10")
    with _node("rx90_controller"), _node("rx90_sim", *parameters) as simulation:
        stamps = _clock_until(lambda _now: simulation.poll() is not None)
    return slope(stamps) * Rates().base_hz


def _free_running_rate(seconds: float) -> float:
    """Return the ticks per second of wall time in free-running time."""
    with _node("rx90_controller"), _node("rx90_sim", "time_mode:=free_running"):
        stamps = _clock_until(lambda now: now > seconds)
    return slope(stamps) * Rates().base_hz


def slope(stamps: Sequence[tuple[float, float]]) -> float:
    """Return simulated time per wall time, the beginning left out: there the graph is still being discovered."""
    tail = stamps[len(stamps) // 10 :]
    return (tail[-1][1] - tail[0][1]) / (tail[-1][0] - tail[0][0])


def _clock_until(done) -> list[tuple[float, float]]:  # type: ignore[no-untyped-def]  # a predicate of simulated time
    """Return (wall time, simulated time) of the messages on /clock, s, until `done`."""
    import rclpy  # after `prepare`
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rosgraph_msgs.msg import Clock

    context = Context()
    rclpy.init(context=context)
    stamps: list[tuple[float, float]] = []
    try:
        node = rclpy.create_node("benchmark", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)

        def take(message: Clock) -> None:
            stamps.append((time.perf_counter(), message.clock.sec + message.clock.nanosec * 1e-9))

        node.create_subscription(Clock, "/clock", take, 10)
        deadline = time.monotonic() + _TIMEOUT
        while not done(stamps[-1][1] if stamps else 0.0):
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline:
                break
        executor.shutdown()
    finally:
        context.try_shutdown()
    if len(stamps) < 20:
        raise ExchangeError(f"the nodes sent {len(stamps)} messages on /clock within {_TIMEOUT:g} s; accepted: 20")
    return stamps


def main() -> int:
    """Print the figures and merge them."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    figures = measure()
    print_table(("figure", "value"), [(key, f"{value:.3f}") for key, value in figures.items()])
    merge(figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
