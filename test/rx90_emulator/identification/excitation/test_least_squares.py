"""Least squares and their deviations, by random arms and formulas written out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import all_columns, plain_arm, rigid_arm, runs_of, truth

from benchmarks.excitation_coverage import Case, Outcome, experiment
from benchmarks.excitation_runs import MISFIT, NOISE, Disturbances
from benchmarks.random_arms import random_arm
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.fit import hac, solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import misfits, residuals_by_speed

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> ExcitationProblem:
    """Return the rows of two runs of an arm of two joints with a coupled motor."""
    arm = plain_arm(8, 2, coupled=True)
    return ExcitationProblem.of(
        rigid_arm(arm, tmp_path_factory.mktemp("arm")), runs_of(arm, 200.0, NOISE, Bandwidths(40.0, 15.0), (1, 2))
    )


def test_intervals_hold_the_truth_where_noise_is_correlated(tmp_path: Path) -> None:
    """Under coloured noise and ripple 95 % intervals hold 90 to 99 % of the true values; textbook ones hold fewer."""
    hits, plain = [], []
    for seed in range(12):
        arm = plain_arm(seed, 2, coupled=bool(seed % 2))
        disturbances = Disturbances(coloured=0.04, corner=2.0, ripple=0.02)
        problem = ExcitationProblem.of(
            rigid_arm(arm, tmp_path), runs_of(arm, 125.0, disturbances, Bandwidths(30.0, 12.0), (seed,))
        )
        columns = all_columns(problem)
        fit = solve(problem, columns)
        scaled = columns / fit.sigma[problem.joint][:, None]
        textbook = np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled)))
        error = np.abs(fit.value - truth(problem, arm))
        hits.append(error < 1.96 * fit.deviation)
        plain.append(error < 1.96 * textbook)
    assert 0.90 <= np.mean(np.concatenate(hits)) <= 0.99
    assert np.mean(np.concatenate(plain)) < 0.85


def test_the_kernel_covariance_is_the_weighted_sum_of_autocovariances() -> None:
    """HAC is Andrews' sum over all lags with his kernel and AR(1) bandwidth, written out, independent between runs."""
    rng = np.random.default_rng(3)
    series = [rng.normal(size=(40, 2)), rng.normal(size=(55, 2))]
    for values in series:
        for k in range(1, len(values)):
            values[k] += 0.6 * values[k - 1]
    both = np.vstack(series)
    rho = [sum((v[1:, k] * v[:-1, k]).sum() for v in series) / (both[:, k] ** 2).sum() for k in range(2)]
    alpha = sum(4 * r**2 / (1 - r) ** 8 for r in rho) / sum(1 / (1 - r) ** 4 for r in rho)
    width = 1.3221 * (alpha * len(both)) ** 0.2

    def kernel(x: float) -> float:
        if x == 0:
            return 1.0
        a = 6 * math.pi * x / 5
        return 25 / (12 * math.pi**2 * x**2) * (math.sin(a) / a - math.cos(a))

    expected = np.zeros((2, 2))
    for values in series:
        for s, one in enumerate(values):
            for t, other in enumerate(values):
                expected += kernel((s - t) / width) * np.outer(one, other)
    assert hac(series) == pytest.approx(expected, rel=1e-9)
    with np.errstate(all="raise"):
        assert not hac([np.zeros((30, 2))]).any()


def test_rows_far_off_weigh_less(problem: ExcitationProblem) -> None:
    """With a twentieth of the rows off by fifty deviations the robust values move by less than plain ones by far."""
    columns = all_columns(problem)
    clean = solve(problem, columns)
    hit = np.random.default_rng(4).random(len(problem)) < 0.05
    torque = problem.torque + 50.0 * clean.sigma[problem.joint] * hit
    robust, weight = solve(problem, columns, torque), 1.0 / clean.sigma[problem.joint]
    plain = np.linalg.lstsq(columns * weight[:, None], torque * weight)[0]
    moved = [float(np.abs((value - clean.value) / clean.deviation).max()) for value in (robust.value, plain)]
    assert moved[0] < 0.2 * moved[1]
    assert robust.weights[hit].max() < 0.1


def test_weights_are_the_joints_noise(problem: ExcitationProblem) -> None:
    """Each joint's sigma is its own noise; a misfit over speed is named with its element, and noise alone is not."""
    columns = all_columns(problem)
    rng, noise = np.random.default_rng(5), np.array([0.5, 0.05])
    exact = columns @ np.ones(columns.shape[1])
    torque = exact + noise[problem.joint] * rng.normal(size=len(problem))
    assert solve(problem, columns, torque).sigma == pytest.approx(noise, rel=0.1)
    runs = tuple(replace(run, torque=noise * rng.normal(size=run.torque.shape)) for run in problem.runs)
    noisy = replace(problem, runs=runs, torque=exact + problem.rows_of([run.torque[:, :, None] for run in runs])[:, 0])
    misfit = solve(replace(noisy, torque=noisy.torque + np.sin(problem.velocity[:, 0] * 2.0)), columns)
    found = residuals_by_speed(noisy, misfit.residual)
    assert np.abs(found[0].residual / found[0].deviation).max() > 5.0
    assert any("joint_1 is off by" in text for text in misfits(found))
    assert misfits(residuals_by_speed(noisy, solve(noisy, columns).residual)) == []


QUANTILE = 3.3
"""Deviations that one of a thousand values exceeds."""


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """Return what came of an arm with coupled wrist, ripple and friction that grows with load, motions played twice."""
    arm = random_arm(1, 2, coupled=True, stribeck=False)
    return experiment(replace(Case.of(arm, MISFIT, 100.0, periods=2, seed=1), motions=12))


def test_intervals_hold_the_truth(outcome: Outcome) -> None:
    """Nine of ten 95 % intervals of base parameters and friction hold the best-fitting values, and none is far off."""
    scores = np.abs([score for kind in ("base", "Coulomb", "viscous", "exponent") for score in outcome.scores[kind]])
    assert len(scores) > 15
    assert np.mean(scores < 1.96) >= 0.9
    assert scores.max() < QUANTILE
    assert np.sqrt(np.mean(scores**2)) > 0.4  # intervals are not far too wide


def test_exponents_are_found_and_an_unseen_run_is_predicted(outcome: Outcome) -> None:
    """Exponents are within 0.05; another run's torque is off by no more than 1.2 times what the best model leaves."""
    assert len(outcome.errors["exponent"]) == 3
    assert np.abs(outcome.errors["exponent"]).max() < 0.05
    assert max(outcome.floor) < 1.2
    assert max(outcome.noise) < 2.0
