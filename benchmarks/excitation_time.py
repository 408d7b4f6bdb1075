"""How long the identification from 45,000 samples of six joints takes: 30 s on two cores, 120 s with bristles.

    python -m benchmarks.excitation_time

From the bags of a random arm with coupled wrist to the result, for runs of 9 s at 5 kHz and of 90 s at 500 Hz: a longer
run has more equations. Merges the figures into out/bench.json; exit code 1 when one is not accepted. A first
identification, which may compile, does not count.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.excitation_runs import MISFIT, FourierMotion, measured, write_run
from benchmarks.random_arms import random_arm
from benchmarks.report import merge, print_table
from rx90_emulator.identification.excitation.identify import identify_excitation
from rx90_emulator.identification.options import RobotOptions

SAMPLES = 45_000
RATES = (5000.0, 500.0)
ACCEPTED = {"without bristles": 30.0, "with bristles": 120.0}


def seconds(rate: float, *, bristles: bool) -> tuple[float, float]:
    """Return elapsed and processor time of an identification, s."""
    arm = random_arm(1, 6, coupled=True, bristles=True)
    duration = SAMPLES / rate
    motion = FourierMotion.random(arm, 1, period=duration - 1.0, periods=1, harmonics=max(4, round(0.5 * duration)))
    with tempfile.TemporaryDirectory() as folder:
        bag, urdf = write_run(measured(arm, motion, rate, 1, MISFIT), arm, Path(folder), wrong=0.3)
        robot = RobotOptions(urdf=urdf, coupling=arm.coupling.ravel().tolist(), spring=arm.spring.tolist())
        began, processor = time.perf_counter(), time.process_time()
        identify_excitation([bag], robot, bristles=bristles)
        return time.perf_counter() - began, time.process_time() - processor


def main() -> int:
    """Print the times and merge them; return 1 if one is not accepted."""
    seconds(RATES[0], bristles=True)
    rows, good = [], True
    for name, limit in ACCEPTED.items():
        for rate in RATES:
            elapsed, processor = seconds(rate, bristles=name == "with bristles")
            label = f"{SAMPLES / rate:g} s at {rate:g} Hz, {name}"
            rows.append((label, f"{elapsed:.1f}", f"{processor:.1f}", f"{limit:g}"))
            key = f"excitation_{name.replace(' ', '_')}_{rate:g}_hz"
            merge({f"{key}_s": elapsed, f"{key}_processor_s": processor})
            good &= elapsed <= limit
    print_table((f"{SAMPLES:,} samples of six joints", "s", "processor s", "at most"), rows)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
