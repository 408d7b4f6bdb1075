"""Measure how well the shipped plan finds known parameters of sliding, and how often its 95 % intervals hold them.

    python -m benchmarks.identification [sets]

The shipped friction and random sets of it, all sweeps of the plan in the closed loop, encoders and control as they
are, then white noise on the torque, at several levels. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from benchmarks.report import merge, print_table
from benchmarks.synthetic_sweeps import STEADY_TORQUE, Noise, random_friction
from rx90_common.friction import FrictionSet
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import Experiment, Kind, make_plan
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.sliding.fit import identify_sliding
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

SETS = 10
LEVELS = {"no noise": 0.0, "half the rig's noise": 0.5, "the rig's noise": 1.0, "twice the rig's noise": 2.0}
BLOCK = 4
"""Samples of joint_states that are averaged into one, as rx90_identify does: 250 Hz."""
TWO_PERCENT = 0.02
COLUMNS = (
    "sliding parameters",
    "median %",
    "95 % below",
    "worst %",
    "within 2 %",
    "covered %",
    "not identifiable",
    "fit s",
)


class Tally:
    """Errors of all parameters at one level of noise."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self.scores: list[float] = []
        self.outside: Counter[str] = Counter()
        self.lacking = 0
        self.seconds: list[float] = []

    def identify(self, records: Sequence[JointRecord], arm: RigidArm, friction: FrictionSet) -> None:
        """Identify one set and compare it with the truth."""
        began = time.perf_counter()
        fit = identify_sliding(records, arm)
        self.seconds.append(time.perf_counter() - began)
        for estimate, element in zip(fit.estimates, friction.elements, strict=True):
            for name, found in estimate.parameters.items():
                true = getattr(element, name)
                if found.identifiable:
                    error = abs(found.value / true - 1.0)
                    self.errors.append(error)
                    self.outside[f"{name} of {estimate.element}"] += error >= TWO_PERCENT
                    self.scores.append(abs(found.value - true) / found.deviation)
                else:
                    self.lacking += 1

    @property
    def covered(self) -> float:
        """Return the share of values within 1.96 deviations."""
        return float(np.mean(np.array(self.scores) < 1.96))

    @property
    def within_2_percent(self) -> float:
        """Return the share of values less than 2 % off."""
        return float(np.mean(np.array(self.errors) < TWO_PERCENT))

    def row(self, label: str) -> tuple[str, ...]:
        """Return what the table shows."""
        errors = np.array(self.errors)
        sizes = [f"{100.0 * value:.2f}" for value in (np.median(errors), np.quantile(errors, 0.95), errors.max())]
        return (
            label,
            *sizes,
            f"{100.0 * self.within_2_percent:.1f}",
            f"{100 * self.covered:.1f}",
            str(self.lacking),
            f"{np.median(self.seconds):.1f}",
        )


def sweep(setup: Setup, experiment: Experiment) -> JointRecord:
    """Run one experiment and return what is read of its bag."""
    run = simulate(setup, experiment.points, experiment.points.position[0], experiment.duration)
    states = run.slow.joint_states
    rows = len(states) // BLOCK
    fields = states[: rows * BLOCK].reshape(rows, BLOCK, 3, 6).mean(axis=1).transpose(1, 0, 2)
    position, velocity, torque = np.ascontiguousarray(fields)
    time_axis = setup.rates.position_period * BLOCK * np.arange(rows)
    return JointRecord(setup.robot.joint_names, time_axis, position, velocity, torque, Path(experiment.name), "0" * 64)


def noisy(record: JointRecord, factor: float, rng: np.random.Generator) -> JointRecord:
    """Add white noise to the torque; its deviation is that of a sample at 1 kHz, before samples are averaged."""
    noise: NDArray[np.float64] = rng.normal(size=record.torque.shape) * STEADY_TORQUE * Noise.torque
    return replace(record, torque=record.torque + factor / np.sqrt(BLOCK) * noise)


def main() -> int:
    """Print the figures and merge those without noise and at the rig's noise."""
    sets = int(sys.argv[1]) if len(sys.argv) > 1 else SETS
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    plan = [one for one in make_plan(setup.robot, setup.drives) if one.kind is Kind.SLIDING]
    tallies = {label: Tally() for label in LEVELS}
    for seed in tqdm(range(sets), unit="set"):
        friction = random_friction(setup.friction, np.random.default_rng(seed)) if seed else setup.friction
        records = [sweep(replace(setup, friction=friction), experiment) for experiment in plan]
        for label, factor in LEVELS.items():
            rng = np.random.default_rng(seed)
            tallies[label].identify([noisy(record, factor, rng) for record in records], arm, friction)
    print_table(COLUMNS, [tally.row(label) for label, tally in tallies.items()])
    for label, tally in tallies.items():
        outside = [f"{name} {count}" for name, count in (+tally.outside).items()]
        print(f"beyond 2 %, {label}: {', '.join(outside) or 'none'}")
    for key, label in (("", "no noise"), ("_noisy", "the rig's noise")):
        tally = tallies[label]
        merge(
            {
                f"identification{key}_coverage": tally.covered,
                f"identification{key}_within_2_percent": tally.within_2_percent,
                f"identification{key}_worst_error": max(tally.errors),
            }
        )
    merge({"identification_sliding_s": float(np.median(tallies["the rig's noise"].seconds))})
    return 0


if __name__ == "__main__":
    sys.exit(main())
