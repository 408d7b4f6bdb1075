"""How well identification finds known parameters of friction, and how often its 95 % intervals hold them.

    python -m benchmarks.identification sliding|presliding [--sets N]

sliding: the shipped friction and random sets of it, all sweeps of the shipped plan in the closed loop, encoders and
control as they are, then white noise on the torque. presliding: random sets (every parameter of every element scaled by
0.5 to 1.5), the presliding experiments of the plan in the closed loop, the sliding regime given with errors as it is
identified. Both at several levels of the friction rig's torque noise. Merges the figures into out/bench.json.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from benchmarks.random_friction import random_friction
from benchmarks.report import arguments, merge, print_table
from benchmarks.synthetic_sweeps import (
    STEADY_TORQUE,
    Noise,
    measured_sliding,
    outcomes,
    random_bristles,
    recorded,
    run_presliding,
)
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import Experiment, Kind, make_plan
from rx90_emulator.identification.presliding import identify_presliding
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.sliding import identify_sliding
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

LEVELS = (0.0, 0.5, 1.0, 2.0)
"""Of the torque noise, in parts of the rig's."""
BLOCK = 4
"""Samples of joint_states that are averaged into one, as rx90 identify does: 250 Hz."""
TWO_PERCENT = 0.02
COLUMNS = (
    "median %",
    "95 % below",
    "worst %",
    "within 2 %",
    "covered %",
    "mean score",
    "not identifiable",
    "fit s",
)


@dataclass
class Tally:
    """Estimates at one level of noise: errors as shares of the true values, and over their deviations; times, s."""

    errors: list[float] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    outside: Counter[str] = field(default_factory=Counter)
    lacking: int = 0
    seconds: list[float] = field(default_factory=list)

    def add(self, name: str, error: float, score: float) -> None:
        """Add an estimate; its error is NaN if it is not identifiable."""
        if np.isnan(error):
            self.lacking += 1
            return
        self.errors.append(abs(error))
        self.scores.append(score)
        self.outside[name] += abs(error) >= TWO_PERCENT

    @property
    def covered(self) -> float:
        """Return the share of values within 1.96 deviations."""
        return float(np.mean(np.abs(self.scores) < 1.96))

    @property
    def within_2_percent(self) -> float:
        """Return the share of values less than 2 % off."""
        return float(np.mean(np.array(self.errors) < TWO_PERCENT))

    def row(self, label: str) -> tuple[str, ...]:
        """Return what the table shows."""
        errors = (np.median(self.errors), np.quantile(self.errors, 0.95), max(self.errors))
        shares = (*errors, self.within_2_percent, self.covered)
        last = (f"{np.mean(self.scores):.2f}", str(self.lacking), f"{np.median(self.seconds):.1f}")
        return (label, *(f"{100.0 * value:.2f}" for value in shares), *last)


def sweep(setup: Setup, experiment: Experiment) -> JointRecord:
    """Run one experiment and return what is read of its bag."""
    run = simulate(setup, experiment.points, experiment.points.position[0], experiment.duration)
    states = run.slow.joint_states
    rows = len(states) // BLOCK
    fields = states[: rows * BLOCK].reshape(rows, BLOCK, 3, 6).mean(axis=1).transpose(1, 0, 2)
    position, velocity, torque = np.ascontiguousarray(fields)
    time_axis = setup.rates.position_period * BLOCK * np.arange(rows)
    return JointRecord(
        setup.robot.joint_names,
        time_axis,
        position,
        velocity,
        torque,
        Path(experiment.name),
        "0" * 64,
    )


def noisy(record: JointRecord, factor: float, rng: np.random.Generator) -> JointRecord:
    """Add white noise to the torque; its deviation is that of a sample at 1 kHz, before samples are averaged."""
    noise: NDArray[np.float64] = rng.normal(size=record.torque.shape) * STEADY_TORQUE * Noise.torque
    return replace(record, torque=record.torque + factor / np.sqrt(BLOCK) * noise)


def sliding(sets: int) -> None:
    """Print the figures of the sliding regime, and merge those at the rig's noise."""
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    plan = [one for one in make_plan(setup.robot, setup.drives) if one.kind is Kind.SLIDING]
    tallies = {level: Tally() for level in LEVELS}
    for seed in tqdm(range(sets), unit="set"):
        friction = (
            random_friction(setup.friction, np.random.default_rng(seed)) if seed else setup.friction
        )
        records = [sweep(replace(setup, friction=friction), experiment) for experiment in plan]
        for level, tally in tallies.items():
            rng = np.random.default_rng(seed)
            disturbed = [noisy(record, level, rng) for record in records]
            began = time.perf_counter()
            fit = identify_sliding(disturbed, arm)
            tally.seconds.append(time.perf_counter() - began)
            named = zip(arm.element_names, fit.estimates, friction.elements, strict=True)
            for joint, estimates, element in named:
                for name, found in estimates.items():
                    true = element.parameters[name]
                    error = found.value / true - 1.0 if found.identifiable else np.nan
                    score = (found.value - true) / found.deviation if found.identifiable else np.nan
                    tally.add(f"{name} of {joint}", error, score)
    _print(
        "sliding parameters",
        {f"noise of the rig x {level:g}": tally for level, tally in tallies.items()},
    )
    noisy_tally = tallies[1.0]
    figures = {"coverage": noisy_tally.covered, "within_2_percent": noisy_tally.within_2_percent}
    merge({f"identification_noisy_{name}": value for name, value in figures.items()})


def presliding(sets: int) -> None:
    """Print the figures of the presliding regime."""
    setup = Setup.load()
    arm = RigidArm.from_setup(setup)
    tallies = {(level, name): Tally() for level in LEVELS for name in ("c0", "c1")}
    for seed in tqdm(range(1, sets + 1), unit="set"):
        friction = random_bristles(setup.friction, np.random.default_rng(seed))
        runs = run_presliding(replace(setup, friction=friction))
        for level in LEVELS:
            rng = np.random.default_rng((seed, round(10 * level)))
            records = [recorded(setup, run, rng, Noise(level * Noise.torque)) for run in runs]
            known = measured_sliding(friction.elements, rng)
            began = time.perf_counter()
            fit = identify_presliding(records, arm, known)
            elapsed = time.perf_counter() - began
            for one in outcomes(fit.estimates, friction.elements):
                name = arm.element_names[one.element]
                tallies[level, one.parameter].add(name, one.error, one.score)
            for name in ("c0", "c1"):
                tallies[level, name].seconds.append(elapsed)
    _print(
        "presliding",
        {f"{name}, noise of the rig x {level:g}": one for (level, name), one in tallies.items()},
    )


def _print(title: str, tallies: dict[str, Tally]) -> None:
    print_table((title, *COLUMNS), [tally.row(label) for label, tally in tallies.items()])
    for label, tally in tallies.items():
        outside = [f"{name} {count}" for name, count in (+tally.outside).items()]
        print(f"beyond 2 %, {label}: {', '.join(outside) or 'none'}")


def main() -> int:
    """Measure what is asked for."""
    options = arguments(
        __doc__,
        ("what", ("sliding", "presliding"), "which regime"),
        ("--sets", 0, "0: 10 of sliding, 5 of presliding"),
    )
    if options.what == "sliding":
        sliding(options.sets or 10)
    else:
        presliding(options.sets or 5)
    return 0


if __name__ == "__main__":
    sys.exit(main())
