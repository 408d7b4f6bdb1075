"""Measure how well the presliding fit finds known c0 and c1, and how often its 95 % intervals hold them.

    python -m benchmarks.identification_presliding [sets]

Random friction sets (every parameter of every element scaled by 0.5 to 1.5), the presliding experiments of the plan in
the closed loop, and the sliding regime given with errors as it is identified; at half, once and twice the torque noise
of the friction rig. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from benchmarks.presliding_runs import (
    Outcome,
    measured_sliding,
    outcomes,
    random_bristles,
    recorded,
    run_presliding,
    sliding_covariance,
)
from benchmarks.report import merge, print_table
from benchmarks.synthetic_sweeps import Noise
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.presliding.fit import identify_presliding
from rx90_emulator.loop.setup import Setup

SETS = 5
LEVELS = (0.0, 0.5, 1.0, 2.0)


def identify(setup: Setup, arm: RigidArm, seed: int, bar: tqdm[None]) -> dict[float, tuple[list[Outcome], float]]:
    """Make a random set of friction, run the experiments, identify it at each level of noise, in s."""
    bar.set_description_str(f"set {seed}, experiments")
    friction = random_bristles(setup.friction, np.random.default_rng(seed))
    truth = replace(setup, friction=friction)
    runs, found = run_presliding(truth), {}
    bar.update()
    for level in LEVELS:
        bar.set_description_str(f"set {seed}, noise x {level:g}")
        rng = np.random.default_rng((seed, round(10 * level)))
        records = [recorded(setup, run, rng, Noise(level * Noise.torque)) for run in runs]
        known = measured_sliding(friction.elements, rng)
        began = time.perf_counter()
        spreads = [sliding_covariance(one) for one in known]
        fit = identify_presliding(records, arm, known, 0.0, spreads, setup.rates.period)
        found[level] = outcomes(fit.estimates, friction.elements), time.perf_counter() - began
        bar.update()
    return found


def main() -> int:
    """Print the figures and merge those at the rig's noise."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else SETS
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    with tqdm(total=sets * (1 + len(LEVELS)), file=sys.stderr) as bar:
        found = [identify(setup, arm, seed, bar) for seed in range(1, sets + 1)]
    rows = []
    for level in LEVELS:
        seconds = float(np.median([one[level][1] for one in found]))
        for name in ("c0", "c1"):
            here = [outcome for one in found for outcome in one[level][0] if outcome.parameter == name]
            known = [outcome for outcome in here if outcome.identifiable]
            error = 100.0 * np.abs([outcome.error for outcome in known])
            score = np.array([outcome.score for outcome in known])
            covered = float(np.mean(np.abs(score) < 1.96))
            figures = (np.median(error), np.quantile(error, 0.95), error.max(), 100.0 * covered, score.mean())
            shown = (f"{value:.2f}" for value in figures)
            rows.append(
                (f"{name}, noise of the rig x {level:g}", *shown, f"{len(here) - len(known)}", f"{seconds:.1f}")
            )
            if level == 1.0:
                merge({f"presliding_{name}_coverage": covered, f"presliding_{name}_worst_error": error.max() / 100.0})
                merge({"presliding_fit_s": seconds})
    headers = (
        "presliding",
        "median %",
        "95 % below",
        "worst %",
        "covered %",
        "mean score",
        "not identifiable",
        "fit s",
    )
    print_table(headers, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
