"""Count the bags, recorded on a busy machine, that lack the trajectory that was sent meanwhile.

    python -m benchmarks.recorded_trajectories [--runs 100] [--busy 2]

In each run simulation, controller and recorder start anew, `rx90 line` sends a line once the recorder is ready, and the
recorder is interrupted as soon as the controller has accepted it, while so many other processes use the processors.
A bag without the trajectory is a fault only where `rx90 line` has sent it and the recorder has ended with 0.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from rosbags.highlevel import AnyReader

from benchmarks.report import arguments, prepare_ros
from rx90_common.process.children import ProcessError, ProcessGroup, executable

ACCEPTED = "/rx90_controller/trajectory_accepted"
LINE = ("--start", 0.6, -0.2, 0.2, "--end", 0.6, -0.1, 0.2, "--approach")


def run(folder: Path) -> str:
    """Record one run; return what the bag lacks, and what the processes said of it."""
    with ProcessGroup(folder, grace=30.0) as group:
        cell = group.start("cell", executable("rx90_cell"))
        recorder = group.start(
            "recorder", executable("rx90 bag", "record", "--output", folder / "bag")
        )
        recorder.wait_for("ready: all")
        line = group.start("line", executable("rx90 line", *LINE))
        said = "sent"
        try:
            line.wait_for("sent ")
            cell.wait_for("trajectory accepted")
        except ProcessError as error:
            said = str(error)
        recorder.signal(signal.SIGINT)
        recorded = recorder.wait()
    with AnyReader([folder / "bag"]) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
    if counts.get(ACCEPTED) and said == "sent" and recorded == 0:
        return "complete"
    lacks = "complete" if counts.get(ACCEPTED) else f"lacks {ACCEPTED}"
    return f"{lacks}; rx90 line: {said}; the recorder ended with {recorded}"


def main() -> int:
    """Count and print; return 1 if a bag lacks a trajectory and nobody said so."""
    options = arguments(
        __doc__, ("--runs", 100, "bags"), ("--busy", 2, "processes that do nothing but compute")
    )
    prepare_ros()
    found: Counter[str] = Counter()
    busy = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.busy)
    ]
    try:
        for number in range(1, options.runs + 1):
            with tempfile.TemporaryDirectory() as folder:
                outcome = run(Path(folder))
            found[outcome] += 1
            print(f"{number}: {outcome}", flush=True)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    for outcome, count in found.most_common():
        print(f"{count} of {options.runs}: {outcome}")
    return int(
        any(
            "lacks" in outcome and outcome.endswith("rx90 line: sent; the recorder ended with 0")
            for outcome in found
        )
    )


if __name__ == "__main__":
    sys.exit(main())
