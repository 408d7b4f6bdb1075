"""Filters and rows of excitation runs, against analytic motions, NumPy and random arms whose truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import Array, plain_arm, rigid_arm, runs_of, standard_values, truth

from benchmarks.excitation_runs import NOISE, NOTHING, FourierMotion, measured
from benchmarks.random_arms import random_arm
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.law import Law, Part
from rx90_emulator.identification.fitted import fit_arm, simplest_fit
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.rows import filtering
from rx90_emulator.identification.rows.excitation import ExcitationProblem, element_states
from rx90_emulator.identification.rows.filtering import (
    Bandwidths,
    filter_record,
    low_pass_taps,
    moving_joints,
    recording_notes,
)
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns

TONES = np.array([[0.7, 0.3], [2.0, 1.1]])  # Hz of each joint


def record(rate: float, seconds: float, *, jitter: float = 0.0, noise: float = 0.0, gap: float = 0.0) -> JointRecord:
    """Return two joints that swing with two tones each, and one that rests; torque is a ramp."""
    rng = np.random.default_rng(0)
    time = np.arange(round(seconds * rate)) / rate
    time = time + jitter / rate * rng.uniform(-1.0, 1.0, len(time))
    if gap:
        time = time[np.abs(time - 0.5 * seconds) > 0.5 * gap]
    angle = 2.0 * np.pi * TONES * time[:, None, None]
    position = np.column_stack([np.sin(angle).sum(axis=2), np.full(len(time), 0.4)])
    position += noise * rng.normal(size=position.shape)
    velocity = np.column_stack([(2.0 * np.pi * TONES * np.cos(angle)).sum(axis=2), 1e-3 * np.sin(time)])
    torque = np.column_stack([time, -time, 0.0 * time])
    return JointRecord(("a", "b", "c"), time, position, velocity, torque, Path("run"), "0")


@pytest.mark.parametrize(("rate", "jitter", "band"), [(1000.0, 0.0, 0.3), (1000.0, 0.0, 0.02), (100.0, 0.2, 0.3)])
def test_velocity_and_acceleration_are_the_motions(rate: float, jitter: float, band: float) -> None:
    """With jittering stamps and to the ends, derivatives are right to 0.5 %, undelayed, as the torque is."""
    (run,) = filter_record(record(rate, 12.0, jitter=jitter), Bandwidths(band * rate, 0.1 * rate))
    omega = 2.0 * np.pi * TONES
    angle = omega * run.time[:, None, None]
    velocity = (omega * np.cos(angle)).sum(axis=2)
    acceleration = -(omega**2 * np.sin(angle)).sum(axis=2)
    assert np.abs(run.velocity[:, :2] - velocity).max() < 5e-3 * np.abs(velocity).max()
    assert np.abs(run.acceleration[:, :2] - acceleration).max() < 5e-3 * np.abs(acceleration).max()
    assert run.parallel(run.torque)[:, 0] == pytest.approx(run.time[run.rows], abs=1e-3 / rate)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_errors_have_the_motions_band_and_fits_a_wider_one_with_clean_accelerations(noise: float) -> None:
    """Twenty times the band of the velocities; up to where white noise is a tenth of the RMS acceleration."""
    log = record(500.0, 20.0, noise=noise)
    compared = Bandwidths.of_motion([log])
    chosen = Bandwidths.of([log])
    assert 20.0 * 1.1 < compared.position < 20.0 * 2.6
    assert chosen.torque == pytest.approx(chosen.position / 3.0)
    square = np.sum((2.0 * np.pi * TONES) ** 4, axis=1) / 2.0
    density = 2.0 * noise**2 / 500.0
    clean = np.median((5.0 * 0.1**2 * square / max(density * (2.0 * np.pi) ** 4, 1e-30)) ** 0.2)
    assert chosen.position == pytest.approx(max(min(clean, 150.0), compared.position), rel=0.1)
    assert Bandwidths.of([record(67.0, 20.0)]).position == pytest.approx(0.3 * 67.0)
    assert moving_joints([record(500.0, 20.0, noise=noise)]).tolist() == [True, True, False]
    assert Bandwidths.of([record(500.0, 20.0)], given=12.0) == (12.0, 4.0)


def test_short_gaps_are_bridged_and_long_ones_split() -> None:
    """A gap of some samples changes a motion by less than 1 %; both kinds are said."""
    bands = Bandwidths(20.0, 7.0)
    (run,) = filter_record(record(500.0, 20.0, gap=0.011), bands)
    angle = 2.0 * np.pi * TONES * run.time[:, None, None]
    assert np.abs(run.position[:, :2] - np.sin(angle).sum(axis=2)).max() < 0.01
    split = record(500.0, 20.0, gap=0.2)
    assert len(filter_record(split, bands)) == 2
    (note,) = recording_notes([split], bands)
    assert "1 gap of up to 0.2" in note


def test_what_cannot_be_filtered_is_refused() -> None:
    """Runs shorter than the filters' edges, and a recording at rest, are refused."""
    with pytest.raises(IdentificationError, match="no stretch of"):
        filter_record(record(50.0, 1.0), Bandwidths(2.0, 1.0))
    still = record(200.0, 5.0)
    with pytest.raises(IdentificationError, match="no joint moves: a, b, c"):
        Bandwidths.of([replace(still, velocity=0.0 * still.velocity)])


def test_the_parallel_filter_is_a_convolution_at_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of any shape are low-passed by the run's symmetric taps at its rows, whole or block by block."""
    (run,) = runs_of(plain_arm(5, 2, coupled=False), 250.0, NOTHING, Bandwidths(40.0, 11.0))
    values = np.random.default_rng(2).normal(size=(len(run.time), 2, 3))
    filtered = run.parallel(values)
    direct = np.convolve(values[:, 1, 2], run.taps, mode="same")[run.rows]
    assert run.down > 1
    assert filtered[:, 1, 2] == pytest.approx(direct, abs=1e-12)
    monkeypatch.setattr(filtering, "_BLOCK_SAMPLES", 500)
    parts = [run.parallel(values[samples]) for samples, _ in run.blocks()]
    assert len(parts) > 3
    assert np.concatenate(parts) == pytest.approx(filtered, abs=1e-12)
    taps = low_pass_taps(500.0, 20.0)
    place = np.arange(len(taps)) - len(taps) // 2
    gain = [taps @ np.cos(2.0 * np.pi * f / 500.0 * place) for f in (0.0, 20.0, 30.0, 40.0, 100.0)]
    assert gain == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0], abs=2e-3)


@pytest.mark.parametrize(("seed", "joints", "coupled"), [(3, 4, True), (5, 3, False)])
def test_exact_runs_give_back_every_parameter(seed: int, joints: int, coupled: bool, tmp_path: Path) -> None:
    """Without noise the base parameters are the groups of the true standard ones, and friction is the true one."""
    arm = plain_arm(seed, joints, coupled=coupled)
    runs = runs_of(arm, 400.0, NOTHING, Bandwidths(100.0, 20.0), periods=1)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    fitted = simplest_fit(problem)
    base, friction = truth(problem, arm)
    assert fitted.determined.all()
    assert fitted.fit.linear == pytest.approx(base, abs=2e-3 * float(np.abs(base).max()))
    assert fitted.fit.x == pytest.approx(friction, rel=1e-2)


def test_base_parameters_are_as_many_as_the_torque_tells(tmp_path: Path) -> None:
    """They are as many as the rank by singular values, and give the torque of all; so, too, where a joint rests."""
    arm = replace(plain_arm(7, 6, coupled=True), spring=np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0]))
    columns = StandardColumns(rigid_arm(arm, tmp_path))
    for rest in (None, np.array([np.nan, 0.3, np.nan, np.nan, -0.2, np.nan])):
        moves = np.full(6, fill_value=True) if rest is None else np.isnan(rest)
        base = BaseGroups.of(columns, rest)
        motion = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 80, 6)) * moves
        motion[0] = np.where(moves, motion[0], 0.0 if rest is None else rest)
        torque = columns.torque(*motion)[:, moves]
        values = np.linalg.svd(torque.reshape(-1, torque.shape[2]), compute_uv=False)
        assert len(base.leading) == int(np.sum(values > 1e-9 * values[0]))
        parameters = base.combination @ standard_values(arm)
        assert torque[:, :, base.leading] @ parameters == pytest.approx(arm.frictionless(*motion)[:, moves], abs=1e-8)


def test_rows_leave_out_pauses_and_joints_at_rest_and_keep_reversals(tmp_path: Path) -> None:
    """A joint's rows are missing where an element on it pauses, the coupled one among them; a reversal stays."""
    arm = plain_arm(4, 2, coupled=True)
    rigid = rigid_arm(arm, tmp_path)
    (run,) = runs_of(arm, 200.0, NOTHING, Bandwidths(40.0, 20.0))
    time = np.arange(len(run.time)) / 200.0
    # Joint 1 turns back at 2 s and pauses after 8 s; joint 2 undoes what joint 1 does from 4 to 6 s.
    rate = np.gradient(np.where(time < 8.0, np.cos(np.pi * np.minimum(time, 8.0) / 4.0), 1.0), time)
    velocity = np.column_stack([rate, np.where((time > 4.0) & (time < 6.0), -rate, 1.0)])
    problem = ExcitationProblem.of(rigid, [replace(run, time=time, velocity=velocity)])
    there = [problem.time[problem.joint == joint] for joint in (0, 1)]
    for times in there:
        assert not np.any((times > 3.98) & (times < 6.02))  # as far as the low-pass of the torque reaches
    assert not np.any(there[0] > 8.0)
    assert np.any(there[1] > 8.5)
    turning = problem.time[problem.reversal & (problem.joint == 0) & (problem.time < 3.9)]
    assert np.all(np.abs(np.sin(np.pi * turning / 4.0)) < 0.1)
    trembling = replace(run, time=time, velocity=velocity * [1.0, 0.01])
    alone = ExcitationProblem.of(rigid, [trembling])
    assert set(alone.joint.tolist()) == set(alone.other(problem.runs).joint.tolist()) == {0}
    assert alone.parameters < problem.parameters
    stops = replace(run, time=time - 5.0, velocity=np.column_stack([2.0 * (time - 5.0) ** 2, 1.0 + 0.0 * time]))
    rests = element_states(stops, np.eye(2))[0][:, 0]
    assert rests[np.argmin(np.abs(stops.time[run.rows]))]


def test_repetitions_share_their_blocks(tmp_path: Path) -> None:
    """Periods of a run, and a run that is played again, have the blocks of the first; another motion has its own."""
    arm = random_arm(3, 2)
    twice = FourierMotion.random(arm, 1, period=6.0, periods=2, harmonics=3)
    motions = [FourierMotion.random(arm, 2, period=10.0, periods=1), twice, twice]
    runs = []
    for number, motion in enumerate(motions):
        runs += filter_record(measured(arm, motion, 100.0, number, NOISE).record(arm), Bandwidths(25.0, 10.0))
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    blocks = [problem.block[problem.run == number] for number in range(3)]
    assert not set(blocks[0]) & set(blocks[1])
    first, again = (blocks[run][problem.joint[problem.run == run] == 0] for run in (1, 2))
    count = min(len(first), len(again))
    assert np.mean(first[:count] == again[:count]) > 0.95
    assert len(np.unique(first)) < 14
    assert (np.diff(first) < 0).sum() >= 1


def test_intervals_of_random_arms_hold(tmp_path: Path) -> None:
    """Of 95 % intervals of base parameters, Coulomb and viscous torques 90 to 98 % hold the truth."""
    inside: list[bool] = []
    for seed in range(8):
        arm = plain_arm(seed, 2 + seed % 2, coupled=False)
        runs = runs_of(arm, 200.0, NOISE, seeds=(seed, seed + 50), periods=1)
        problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
        fitted = simplest_fit(problem)
        base, friction = truth(problem, arm)
        inside += (np.abs(fitted.values - np.append(friction, base)) < 1.96 * fitted.deviation).tolist()
    assert len(inside) > 150
    assert 0.9 < np.mean(inside) < 0.985


def test_a_bristle_shows_along_the_motion(tmp_path: Path) -> None:
    """Of an arm with soft bristles the fit with them leaves less, and finds the stiffness."""
    arm = random_arm(11, 2, coupled=False, stribeck=False, bristles=True)
    runs = runs_of(arm, 500.0, NOISE, Bandwidths(120.0, 40.0), seeds=(1, 2), periods=1)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    fitted = fit_arm(problem, [Part.BRISTLE], fixed=True)
    assert any(law == Law(frozenset({Part.BRISTLE})) for law in fitted.laws)
    size: Array = simplest_fit(problem).fit.residual
    assert np.linalg.norm(fitted.fit.residual) < np.linalg.norm(size)
    for number, law in enumerate(arm.friction):
        estimate = fitted.estimates(number)["c0"]
        if estimate.identifiable:
            assert abs(estimate.value - law.c0) < 4.0 * estimate.deviation
