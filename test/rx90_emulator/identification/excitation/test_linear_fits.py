"""Least squares, their deviations, instrumental variables and drive gains, by random arms and formulas written out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import all_columns, plain_arm, rigid_arm, runs_of, truth

from benchmarks.excitation_runs import NOISE, NOTHING, Disturbances
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.friction import identify_friction_parts
from rx90_emulator.identification.excitation.instruments import check_closed_loop
from rx90_emulator.identification.excitation.known_payload import drive_gains
from rx90_emulator.identification.excitation.least_squares import hac, outside_residuals, solve, time_blocks
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import misfits, residuals_by_speed


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
        _, columns = all_columns(problem)
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


def test_outside_residuals_are_those_of_fits_without_the_block(problem: ExcitationProblem) -> None:
    """Each block's residuals are those of a fit to the other blocks alone, made again here."""
    columns, block = problem.regressor, time_blocks(problem)
    value = np.linalg.lstsq(columns, problem.torque, rcond=None)[0]
    found = outside_residuals(columns, columns, problem.torque - columns @ value, block)
    for number in (0, int(block.max())):
        inside = block == number
        other = np.linalg.lstsq(columns[~inside], problem.torque[~inside], rcond=None)[0]
        assert found[inside] == pytest.approx(problem.torque[inside] - columns[inside] @ other, abs=1e-6)


def test_both_kinds_of_deviations_agree(problem: ExcitationProblem) -> None:
    """Deviations from resampled blocks of time are those from autocovariances within a third, in the median."""
    _, columns = all_columns(problem)
    fit = solve(problem, columns)
    target, block = columns @ fit.value + fit.residual, time_blocks(problem)
    root = (np.sqrt(fit.weights) / fit.sigma[problem.joint])[:, None]
    rows, right = root * columns, root[:, 0] * target
    parts = [(rows[block == k].T @ rows[block == k], rows[block == k].T @ right[block == k]) for k in np.unique(block)]
    grams, products = (np.array(part) for part in zip(*parts, strict=True))
    draws = np.random.default_rng(0).multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)), 200)
    values = [np.linalg.solve(np.tensordot(k, grams, 1), np.tensordot(k, products, 1)) for k in draws]
    resampled = np.std(values, axis=0)
    assert np.median(resampled / fit.deviation) == pytest.approx(1.0, abs=0.33)


def test_rows_far_off_weigh_less(problem: ExcitationProblem) -> None:
    """With a twentieth of the rows off by fifty deviations the robust values move by less than plain ones by far."""
    _, columns = all_columns(problem)
    clean = solve(problem, columns)
    rng = np.random.default_rng(4)
    hit = rng.random(len(problem)) < 0.05
    torque = problem.torque + 50.0 * clean.sigma[problem.joint] * hit
    robust, weight = solve(problem, columns, torque), 1.0 / clean.sigma[problem.joint]
    plain = np.linalg.lstsq(columns * weight[:, None], torque * weight)[0]
    moved = [float(np.abs((value - clean.value) / clean.deviation).max()) for value in (robust.value, plain)]
    assert moved[0] < 0.2 * moved[1]
    assert robust.weights[hit].max() < 0.1


def test_weights_are_the_joints_noise(problem: ExcitationProblem) -> None:
    """Each joint's sigma is its own noise; a misfit over speed is named with its element, and noise alone is not."""
    _, columns = all_columns(problem)
    rng = np.random.default_rng(5)
    noise = np.array([0.5, 0.05])
    exact = columns @ np.ones(columns.shape[1])
    torque = exact + noise[problem.joint] * rng.normal(size=len(problem))
    assert solve(problem, columns, torque).sigma == pytest.approx(noise, rel=0.1)
    runs = tuple(replace(run, torque=noise * rng.normal(size=run.torque.shape)) for run in problem.runs)
    noisy = replace(problem, runs=runs, torque=exact + problem.rows_of([run.torque[:, :, None] for run in runs])[:, 0])
    fit = solve(noisy, columns)
    misfit = solve(replace(noisy, torque=noisy.torque + np.sin(problem.velocity[:, 0] * 2.0)), columns)
    found = residuals_by_speed(noisy, misfit.residual)
    assert np.abs(found[0].residual / found[0].deviation).max() > 5.0
    assert any("joint_1 is off by" in text for text in misfits(found))
    assert misfits(residuals_by_speed(noisy, fit.residual)) == []


def test_instruments_undo_the_bias_of_a_closed_loop(tmp_path: Path) -> None:
    """Where the loop's noise moves the arm least squares miss the truth by far; instruments are taken and hold it."""
    arm = plain_arm(1, 2, coupled=True)
    runs = runs_of(arm, 125.0, Disturbances(feedback=1e-3), Bandwidths(37.0, 18.0), (100,), 1)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    found, taken = check_closed_loop(problem, identify_friction_parts(problem, ()))
    expected = truth(problem, arm)
    missed = np.abs(found.least_squares.value - expected) / found.least_squares.deviation
    held = np.abs(found.instrumental.value - expected) / found.instrumental.deviation
    assert missed.max() > 5.0
    assert np.mean(held < 1.96) >= 0.85
    assert held.max() < 4.0
    assert np.array_equal(taken.fit.value, found.instrumental.value)
    assert "the recorded set-points" in found.controller
    assert found.reason.startswith("instrumental variables are taken")


def test_least_squares_are_taken_where_instruments_agree(tmp_path: Path) -> None:
    """Without noise in the loop both agree, with measured paths in place of set-points, and the reader is told."""
    arm = plain_arm(3, 2, coupled=False)
    runs = [replace(run, reference=None) for run in runs_of(arm, 125.0, NOISE, seeds=(300,), periods=1)]
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    friction = identify_friction_parts(problem, ())
    found, taken = check_closed_loop(problem, friction)
    assert taken is friction
    assert "the measured path" in found.controller
    assert "least squares are taken" in found.reason


def test_a_known_payload_tells_the_drive_gains(tmp_path: Path) -> None:
    """With recorded torques too small or large by a tenth, runs with and without a payload give the true factors.

    The coupled motor's acts on both joints. With them the base parameters are the true ones. Torques in a unit 400
    times as large have 400 times the gains, told just as well, which hardly are a drive's.
    """
    arm = plain_arm(3, 3, coupled=True)
    payload = Payload(6.0, (0.1, -0.05, 0.15), 0.02 * np.eye(3))
    factor = np.array([1.1, 0.92, 1.05])
    scale = np.linalg.inv(arm.coupling) @ np.diag(1.0 / factor) @ arm.coupling
    rigid = rigid_arm(arm, tmp_path)
    runs = runs_of(arm, 200.0, NOISE, Bandwidths(40.0, 15.0), (1, 2))
    true = ExcitationProblem.of(rigid, runs, payloads=[None, payload])
    last = true.columns.torque(runs[1].position, runs[1].velocity, runs[1].acceleration)[:, :, 20:30]
    torques = runs[0].torque, runs[1].torque + last @ payload.parameters()
    recorded = [replace(run, torque=torque @ scale) for run, torque in zip(runs, torques, strict=True)]
    problem = ExcitationProblem.of(rigid, recorded, payloads=[None, payload])
    _, friction = coulomb_viscous(problem)
    gains = drive_gains(problem, friction)
    assert np.all(np.abs(gains.factor - factor) < 3.0 * gains.deviation)
    assert gains.deviation.max() < 0.01
    assert len(gains.implausible) == 0
    again = gains.after(np.array([2.0, 0.5, 1.0]))  # as if these had been multiplied in before
    assert again.factor == pytest.approx(gains.factor * [2.0, 0.5, 1.0])
    assert again.deviation == pytest.approx(gains.deviation * [2.0, 0.5, 1.0])
    other = [replace(run, torque=run.torque / 400.0) for run in recorded]
    scaled = drive_gains(ExcitationProblem.of(rigid, other, payloads=[None, payload]), friction)
    assert scaled.factor == pytest.approx(400.0 * gains.factor, rel=1e-3)
    assert scaled.deviation.max() > 0.1
    assert scaled.implausible.tolist() == scaled.told.tolist() == [0, 1, 2]
    corrected = gains.applied(problem)
    _, columns = all_columns(corrected)
    fit = solve(corrected, columns)
    assert np.mean(np.abs(fit.value - truth(true, arm)) < 2.5 * fit.deviation) > 0.9
    # The gains' own deviations are in those of what scales with them, as where each gain is off by one of them.
    sure = solve(replace(corrected, uncertain=corrected.uncertain[:, :0]), columns)
    scaled_by = [solve(replace(gains, factor=gains.factor + gains.deviation * unit).applied(problem), columns).value
                 for unit in np.eye(3)]  # fmt: skip
    variance = sure.deviation**2 + np.sum((np.array(scaled_by) - fit.value) ** 2, axis=0)
    assert fit.deviation == pytest.approx(np.sqrt(variance), rel=0.25)
    assert np.max(fit.deviation / sure.deviation) > 1.3


def test_a_motor_whose_gain_is_lost_in_noise_keeps_it(tmp_path: Path) -> None:
    """With 40 Nm of noise on the last joint the payload tells the first one's gain alone; the other stays 1."""
    arm = plain_arm(8, 2, coupled=False)
    body = Payload(8.0, (0.1, 0.0, 0.05), 0.02 * np.eye(3))
    rigid = rigid_arm(arm, tmp_path)
    runs = runs_of(arm, 100.0, NOISE, Bandwidths(25.0, 10.0), (1, 2), periods=1)
    columns = ExcitationProblem.of(rigid, runs).columns
    load = columns.torque(runs[1].position, runs[1].velocity, runs[1].acceleration)[:, :, 10:20] @ body.parameters()
    recorded = [runs[0], replace(runs[1], torque=runs[1].torque + load)]
    rng = np.random.default_rng(0)
    recorded = [
        replace(run, torque=run.torque / 1.1 + rng.normal(size=run.torque.shape) * [0.0, 40.0]) for run in recorded
    ]
    problem = ExcitationProblem.of(rigid, recorded, payloads=[None, body])
    gains = drive_gains(problem, coulomb_viscous(problem)[1])
    assert gains.told.tolist() == [0]
    assert gains.factor == pytest.approx([1.1, 1.0], abs=3.0 * gains.deviation[0])
    assert gains.factor[1] == 1.0
    assert gains.deviation[1] == np.inf


@pytest.mark.parametrize("which", [(None, None), (1, 1)])
def test_gains_without_a_payload_that_tells_them_are_refused(
    which: tuple[int | None, int | None], tmp_path: Path
) -> None:
    """Without a payload, or with one that never comes off, the answer is a refusal."""
    arm = plain_arm(8, 2, coupled=False)
    body = Payload(2.0, (0.1, 0.0, 0.0), 0.01 * np.eye(3))
    runs = runs_of(arm, 100.0, NOTHING, Bandwidths(20.0, 10.0), (1, 2))
    payloads = [None if one is None else body for one in which]
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs, payloads=payloads)
    with pytest.raises(IdentificationError, match="the same payload"):
        drive_gains(problem, coulomb_viscous(problem)[1])
