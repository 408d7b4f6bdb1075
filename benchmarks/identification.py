"""Measure how well the sliding fit finds known parameters, and how often its 95 % intervals hold them.

    python -m benchmarks.identification [sets]

Random friction sets, three levels of torque noise, with and without errors that a whole stretch has in common;
sweeps of all joints by an analytic Stribeck curve and Pinocchio. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

import numpy as np

from benchmarks.report import merge, print_table
from benchmarks.synthetic_sweeps import Noise, Program, drive_torque, measured, random_friction
from rx90_identification.rigid_arm import RigidArm
from rx90_identification.sliding import identify_sliding
from rx90_loop.setup import Setup

SETS = 12
LEVELS = {
    "half the rig's noise": Noise(0.5 * Noise.torque),
    "the rig's noise": Noise(),
    "the rig's noise, 0.1 % in common": Noise(common=1e-3),
    "twice the rig's noise": Noise(2.0 * Noise.torque),
}
PROGRAM = Program(range(6), count=12, poses=2, longest=2.5)


class Outcome(NamedTuple):
    """Relative errors and errors in standard deviations of all parameters that were told, and how many were not."""

    errors: list[float]
    scores: list[float]
    untold: int
    seconds: float


def identify(setup: Setup, arm: RigidArm, noise: Noise, seed: int) -> Outcome:
    """Make a random set of friction, measure it, identify it."""
    rng = np.random.default_rng(seed)
    friction = random_friction(setup.friction, rng)
    motion = PROGRAM.motion(setup, seed)
    record = measured(setup, motion, drive_torque(setup, friction, motion), rng, noise)
    began = time.perf_counter()
    fit = identify_sliding([record], arm)
    seconds = time.perf_counter() - began
    errors, scores, untold = [], [], 0
    for estimate, element in zip(fit.estimates, friction.elements, strict=True):
        for name, found in estimate.parameters.items():
            true = getattr(element, name)
            if found.identifiable:
                errors.append(abs(found.value / true - 1.0))
                scores.append(abs(found.value - true) / found.deviation)
            else:
                untold += 1
    return Outcome(errors, scores, untold, seconds)


def main() -> int:
    """Print the figures and merge those at the rig's noise."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else SETS
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    rows = []
    for label, noise in LEVELS.items():
        outcomes = [identify(setup, arm, noise, seed) for seed in range(sets)]
        errors = np.concatenate([outcome.errors for outcome in outcomes])
        covered = float(np.mean(np.concatenate([outcome.scores for outcome in outcomes]) < 1.96))
        untold = sum(outcome.untold for outcome in outcomes)
        seconds = float(np.median([outcome.seconds for outcome in outcomes]))
        figures = [f"{100 * value:.2f}" for value in (np.median(errors), np.quantile(errors, 0.95), errors.max())]
        rows.append((label, *figures, f"{100 * covered:.1f}", str(untold), f"{seconds:.1f}"))
        if noise == Noise():
            merge({"identification_coverage": covered, "identification_worst_error": float(errors.max())})
            merge({"identification_sliding_s": seconds})
    print_table(("sliding parameters", "median %", "95 % below", "worst %", "covered %", "not told", "fit s"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
