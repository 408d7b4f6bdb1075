"""How long the identification from 45,000 samples of six joints takes: 30 s on two cores, 120 s with bristles.

    python -m benchmarks.excitation_time

A random arm with coupled wrist, recorded for 9 s at 5 kHz, and for 90 s at 500 Hz: a long run has more equations. Merges
the figures into out/bench.json; exit code 1 when one is not accepted. The first identification may compile and does not
count.
"""

from __future__ import annotations

import sys
import time

from benchmarks.excitation_experiment import Case
from benchmarks.excitation_runs import MISFIT, FourierMotion, measured
from benchmarks.random_arms import random_arm
from benchmarks.report import merge, print_table
from rx90_emulator.identification.excitation.friction.identify import (
    ALL_PARTS,
    WITHOUT_BRISTLES,
    identify_friction_parts,
)

SAMPLES = 45_000
RATES = (5000.0, 500.0)
ACCEPTED = {"without bristles": 30.0, "with bristles": 120.0}


def seconds(rate: float, *, bristles: bool, samples: int = SAMPLES) -> tuple[float, float]:
    """Return elapsed and processor time of one identification, filters and equations among it, s."""
    arm = random_arm(1, 6, coupled=True, bristles=True)
    case = Case.of(arm, MISFIT, rate)
    motion = FourierMotion.random(arm, 1, period=samples / rate - 1.0, periods=1, harmonics=round(0.5 * samples / rate))
    run = measured(arm, motion, rate, 1, MISFIT)
    began, processor = time.perf_counter(), time.process_time()
    problem = case.problem([run])
    identify_friction_parts(problem, ALL_PARTS if bristles else WITHOUT_BRISTLES)
    return time.perf_counter() - began, time.process_time() - processor


def main() -> int:
    """Print the times and merge them; return 1 if one is not accepted."""
    seconds(RATES[0], bristles=True, samples=10_000)
    rows, good = [], True
    for name, limit in ACCEPTED.items():
        for rate in RATES:
            elapsed, processor = seconds(rate, bristles=name == "with bristles")
            rows.append(
                (f"{SAMPLES / rate:g} s at {rate:g} Hz, {name}", f"{elapsed:.1f}", f"{processor:.1f}", f"{limit:g}")
            )
            merge({f"excitation_time_{name.replace(' ', '_')}_{rate:g}_s": elapsed})
            good &= elapsed <= limit
    print_table((f"{SAMPLES:,} samples of six joints", "s", "processor s", "at most"), rows)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
