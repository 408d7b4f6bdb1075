"""Measure the recorder: CPU share, memory and completeness at 12,000 messages per second.

    python benchmarks/bench_recorder.py [--seconds 10] [--storage mcap|sqlite3]

A process publishes two topics at 4 kHz and four at 1 kHz as the suite does, `rx90_bag record` records them in another
process, and this one reads what the system says of that process's time and memory.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from rx90_common.bags.summary import summarise
from rx90_common.process.children import executable

ROOT = Path(__file__).resolve().parent.parent
FAST = ("motor_states", "motor_commands")
SLOW = ("joint_states", "friction_states", "rx90_controller/reference", "rx90_controller/tracking_error")
TICK_NS = 250_000
TICK_HZ = 4000


def publish(seconds: float) -> None:
    """Publish at the suite's rates, paced by a steady clock; print the achieved tick rate."""
    import rclpy  # only in the process that publishes
    from sensor_msgs.msg import JointState

    from rx90_common.exchange.cdr import JointStateCodec
    from rx90_common.exchange.endpoints import STATE_QOS, TICK_QOS
    from rx90_common.exchange.ros_start import prepare

    prepare()
    rclpy.init()
    node = rclpy.create_node("bench_publisher")
    fast = [node.create_publisher(JointState, topic, TICK_QOS.profile) for topic in FAST]
    slow = [node.create_publisher(JointState, topic, STATE_QOS.profile) for topic in SLOW]
    codec = JointStateCodec([f"motor_{i}" for i in range(1, 7)])
    values = np.arange(6.0)
    sys.stdin.readline()
    start = time.monotonic()
    for tick in range(round(seconds * TICK_HZ)):
        time.sleep(max(0.0, start + tick / TICK_HZ - time.monotonic()))
        raw = codec.encode(tick * TICK_NS, values, values, values)
        for publisher in fast if tick % 4 else fast + slow:
            publisher.publish(raw)
    print(seconds * TICK_HZ / (time.monotonic() - start), flush=True)
    sys.stdin.readline()


def cpu_seconds(pid: int) -> float:
    """Return user and system time of a process in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def peak_memory_mb(pid: int) -> float:
    """Return the largest resident set of a process so far in MB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024


def measure(seconds: float, storage: str, folder: Path) -> dict[str, float | str]:
    """Record a run of the publisher and return the figures.

    Raises:
        RuntimeError: if the recorder lost a message.
    """
    own = [sys.executable, __file__, "--publish", "--seconds", str(seconds)]
    record = executable("rx90_bag", "record", "-o", folder / "bag", "-s", storage, *FAST, *SLOW)
    pipe = subprocess.PIPE
    with (
        subprocess.Popen(own, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as publisher,
        subprocess.Popen(record, stdout=pipe, text=True, cwd=ROOT) as recorder,
    ):
        try:
            assert recorder.stdout is not None
            assert publisher.stdin is not None
            assert publisher.stdout is not None
            while not recorder.stdout.readline().startswith("ready"):
                pass
            before, start = cpu_seconds(recorder.pid), time.monotonic()
            publisher.stdin.write("start\n")
            publisher.stdin.flush()
            rate = float(publisher.stdout.readline())
            share = (cpu_seconds(recorder.pid) - before) / (time.monotonic() - start)
            memory = peak_memory_mb(recorder.pid)
            recorder.send_signal(signal.SIGINT)
            if recorder.wait() != 0:
                raise RuntimeError(f"the recorder ended with exit code {recorder.returncode}")
        finally:
            recorder.kill()
            publisher.kill()
    summary = summarise(folder / "bag")
    ticks = round(seconds * TICK_HZ)
    expected = len(FAST) * ticks + len(SLOW) * ((ticks + 3) // 4)
    if summary.count != expected:
        raise RuntimeError(f"{summary.count} messages are in the bag; sent: {expected}")
    return {
        "storage": storage,
        "recorder_messages": summary.count,
        "recorder_messages_per_s": rate * (len(FAST) + len(SLOW) / 4),
        "recorder_cpu_share": share,
        "recorder_cpu_us_per_message": share / (rate * (len(FAST) + len(SLOW) / 4)) * 1e6,
        "recorder_peak_memory_mb": memory,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the run in s (default: 10)")
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap")
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.publish:
        publish(args.seconds)
        return
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 101)
    os.environ["PYTHONPATH"] = f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(args.seconds, args.storage, Path(folder)), indent=2))


if __name__ == "__main__":
    main()
