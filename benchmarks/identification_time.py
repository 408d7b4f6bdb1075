"""How long identifications take on this machine: seven elements from bags, or 45,000 samples of six joints.

    python -m benchmarks.identification_time bags|excitation

bags: a series written on the engine; at most 40 s on two cores. excitation: from the bags of a random arm with coupled
wrist to the result, for runs of 9 s at 5 kHz and of 90 s at 500 Hz, since a longer run has more equations; at most 30 s
on two cores, 120 s with bristles. Merges the figures into out/bench.json; exit code 1 when one is not accepted. A first
identification, which may compile, does not count.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.excitation_runs import MISFIT, FourierMotion, measured, write_run
from benchmarks.random_arms import random_arm
from benchmarks.report import accepted, arguments, merge, print_table
from rx90_common.process.children import executable
from rx90_emulator.identification.excitation import identify_excitation
from rx90_emulator.identification.options import RobotOptions

BAGS_LIMIT = 40.0
SAMPLES = 45_000
RATES = (5000.0, 500.0)
EXCITATION_LIMITS = {"without bristles": 30.0, "with bristles": 120.0}


def bags() -> list[str]:
    """Time `rx90 identify` on a series; return what is not accepted."""
    with tempfile.TemporaryDirectory() as folder:
        series, elapsed = Path(folder) / "series", 0.0
        subprocess.run(
            executable("rx90 experiment sliding", "engine", "--output", str(series)), check=True
        )
        for _ in range(2):
            began = time.perf_counter()
            output = str(Path(folder) / "friction.yaml")
            subprocess.run(
                executable("rx90 identify sliding", str(series), "--output", output, "--force"),
                check=True,
            )
            elapsed = time.perf_counter() - began
    print(
        f"identification of seven elements from bags: {elapsed:.1f} s (accepted: at most {BAGS_LIMIT:g} s)"
    )
    merge({"identification_bags_s": elapsed})
    return [] if elapsed <= BAGS_LIMIT else ["identification from bags"]


def excitation_seconds(rate: float, *, bristles: bool) -> tuple[float, float]:
    """Return elapsed and processor time of an identification from an excitation run, s."""
    arm = random_arm(1, 6, coupled=True, bristles=True)
    duration = SAMPLES / rate
    motion = FourierMotion.random(
        arm, 1, period=duration - 1.0, periods=1, harmonics=max(4, round(0.5 * duration))
    )
    with tempfile.TemporaryDirectory() as folder:
        bag, urdf = write_run(measured(arm, motion, rate, 1, MISFIT), arm, Path(folder), wrong=0.3)
        robot = RobotOptions(
            urdf=urdf, coupling=arm.coupling.ravel().tolist(), spring=arm.spring.tolist()
        )
        began, processor = time.perf_counter(), time.process_time()
        identify_excitation([bag], robot, bristles=bristles)
        return time.perf_counter() - began, time.process_time() - processor


def excitation() -> list[str]:
    """Print and merge the times with and without bristles; return what is not accepted."""
    excitation_seconds(RATES[0], bristles=True)
    rows, wrong = [], []
    for name, limit in EXCITATION_LIMITS.items():
        for rate in RATES:
            elapsed, processor = excitation_seconds(rate, bristles=name == "with bristles")
            label = f"{SAMPLES / rate:g} s at {rate:g} Hz, {name}"
            rows.append((label, f"{elapsed:.1f}", f"{processor:.1f}", f"{limit:g}"))
            key = f"excitation_{name.replace(' ', '_')}_{rate:g}_hz"
            merge({f"{key}_processor_s": processor})
            wrong += [label] if elapsed > limit else []
    print_table((f"{SAMPLES:,} samples of six joints", "s", "processor s", "at most"), rows)
    return wrong


def main() -> int:
    """Measure what is asked for; return 1 if a time is not accepted."""
    options = arguments(__doc__, ("what", ("bags", "excitation"), "which identification"))
    return accepted(bags() if options.what == "bags" else excitation())


if __name__ == "__main__":
    sys.exit(main())
