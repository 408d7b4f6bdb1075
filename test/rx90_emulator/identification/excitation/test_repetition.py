"""Repetitions of a motion in excitation runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.excitation_runs import NOISE, NOTHING, Disturbances, FourierMotion, measured
from benchmarks.random_arms import random_arm
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun, filter_record
from rx90_emulator.identification.excitation.least_squares import solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem, phases
from rx90_emulator.identification.records import BagSource


def test_instants_of_equal_phase_are_the_same_point_of_the_same_motion() -> None:
    """Periods of a run, and a run that is played again, share their phases; other motions have their own."""
    arm = random_arm(3, 2)
    twice = FourierMotion.random(arm, 1, period=6.0, periods=2, harmonics=3)
    once = replace(twice, periods=1, rest=1.2)
    motions = [FourierMotion.random(arm, 2, period=10.0, periods=1), twice, once]
    runs, exact = [], []
    for number, motion in enumerate(motions):
        run = measured(arm, motion, 100.0, number, NOISE)
        (filtered,) = filter_record(run.record(arm), Bandwidths(25.0, 10.0))
        runs.append(filtered)
        exact.append(motion.at(filtered.time[filtered.rows])[0])
    (first, alone), (second, folded), (third, again) = phases(runs)
    assert (first, second, third) == (0, 1, 1)
    assert np.array_equal(alone, np.arange(len(alone)))
    period = round(6.0 * runs[1].rate / runs[1].down)
    assert set(folded.tolist()) == set(range(period))
    both = np.concatenate([folded, again])
    positions = np.concatenate(exact[1:])
    moving = np.concatenate([np.abs(run.velocity[run.rows]).max(axis=1) > 0.3 for run in runs[1:]])
    widths = [np.ptp(positions[(both == phase) & moving], axis=0).max() for phase in set(both[moving].tolist())]
    assert len(widths) > 0.8 * period
    assert max(widths) < 0.15  # a row's time at some 3 rad/s


def test_what_is_no_repetition_is_not_taken_for_one() -> None:
    """Another motion of the smaller joint, another pace, and a tenth in common make another motion, 60 % does not.

    A recording that begins earlier than the first of its motion has its phases from 0 on.
    """
    rng = np.random.default_rng(0)
    waves = np.cumsum(rng.normal(size=(3000, 4)), axis=0)
    waves = np.sin(0.05 * (waves - np.linspace(0.0, 1.0, 3000)[:, None] * waves[-1]) + np.arange(4))
    size = np.array([2.0, 0.05])

    def run(velocity: np.ndarray, rate: float = 100.0) -> FilteredRun:
        time = np.arange(len(velocity)) / rate
        source = BagSource(Path("run"), "", float(time[-1]), 0, 0)
        motion = [size * velocity] * 4
        return FilteredRun(source, ("a", "b"), time, *motion, None, Bandwidths(25.0 * rate / 100.0, rate / 10.0))

    first, other = waves[:, :2], waves[:, 2:]
    given = [
        run(first[500:]),
        run(first),
        run(np.column_stack([first[:, 0], other[:, 1]])),
        run(first, 200.0),
        run(np.vstack([first[2700:], other[:2700]])),
        run(np.vstack([first[1200:], other[:1200]])),
    ]
    found = phases(given)
    numbers = [number for number, _ in found]
    assert numbers == [0, 0, 1, 2, 3, 0]
    assert (found[1][1].min(), found[0][1].min()) == (0, 500 // given[0].down)


def test_a_motion_that_is_repeated_says_no_more_of_what_the_model_leaves_out(tmp_path: Path) -> None:
    """Deviations from a misfit alone are those of one recording however often it is repeated; noise averages out."""
    arm = random_arm(3, 2, stribeck=False)
    (tmp_path / "arm.urdf").write_text(arm.urdf(), encoding="utf-8")
    rigid = RigidArm.from_urdf(tmp_path / "arm.urdf", coupling=arm.coupling, spring=arm.spring)

    def deviation(disturbances: Disturbances, seeds: list[int]) -> np.ndarray:
        motion = FourierMotion.random(arm, 1, period=12.0, periods=1)
        records = [measured(arm, motion, 100.0, seed, disturbances).record(arm) for seed in seeds]
        runs = [run for record in records for run in filter_record(record, Bandwidths(25.0, 10.0))]
        problem = ExcitationProblem.of(rigid, runs)
        return solve(problem, np.hstack([problem.regressor, coulomb_viscous(problem)[1]])).deviation

    misfit, noise = replace(NOTHING, ripple=0.02, load=0.05), replace(NOTHING, white=0.3)
    assert deviation(misfit, [1, 1, 1, 1]) == pytest.approx(deviation(misfit, [1]), rel=0.05)
    averaged = deviation(noise, [1, 2, 3, 4]) / deviation(noise, [1])
    assert np.median(averaged) == pytest.approx(0.5, abs=0.15)
