"""Filtering and the linear model of excitation runs, against analytic motions, Pinocchio and random arms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import Array, all_columns, plain_arm, rigid_arm, runs_of, standard_values, truth

from benchmarks.excitation_runs import NOISE, NOTHING, Disturbances, FourierMotion, measured
from benchmarks.random_arms import random_arm
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation import filtering
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun, filter_record, low_pass_taps
from rx90_emulator.identification.excitation.fit import solve
from rx90_emulator.identification.excitation.law import coulomb_viscous
from rx90_emulator.identification.excitation.problem import (
    BaseGroups,
    ExcitationProblem,
    StandardColumns,
    element_states,
    phases,
)
from rx90_emulator.identification.excitation.result import undetermined
from rx90_emulator.identification.records import BagSource, JointRecord

TONES = np.array([[0.7, 0.3], [2.0, 1.1]])  # Hz of each joint


def record(
    rate: float, seconds: float, *, jitter: float = 0.0, noise: float = 0.0, gap: float = 0.0, factor: float = 1.0
) -> JointRecord:
    """Return two joints that swing with two tones each; torque is a ramp, with noise where the positions have some."""
    rng = np.random.default_rng(0)
    time = np.arange(round(seconds * rate)) / rate
    time = time + jitter / rate * rng.uniform(-1.0, 1.0, len(time))
    if gap:
        time = time[np.abs(time - 0.5 * seconds) > 0.5 * gap]
    angle = 2.0 * np.pi * factor * TONES * time[:, None, None]
    position = np.sin(angle).sum(axis=2) + noise * rng.normal(size=(len(time), 2))
    torque = np.column_stack([time, -time]) + bool(noise) * 1e-2 * rng.normal(size=(len(time), 2))
    return JointRecord(("a", "b"), time, position, np.zeros_like(position), torque, Path("run"), "0")


@pytest.mark.parametrize(
    ("rate", "jitter", "factor", "band"),
    [(1000.0, 0.0, 1.0, 0.3), (1000.0, 0.0, 1.0, 0.02), (100.0, 0.2, 1.0, 0.3), (67.0, 0.0, 3.0, 0.3)],
)
def test_velocity_and_acceleration_are_the_motions_own(rate: float, jitter: float, factor: float, band: float) -> None:
    """With jittering stamps, of 6 Hz in samples at 67 Hz, and to the ends, derivatives are right to 0.5 %, undelayed.

    Set-points are resampled as positions are.
    """
    given = record(rate, 12.0, jitter=jitter, factor=factor)
    (run,) = filter_record(given, Bandwidths(band * rate, 0.1 * rate), reference=given.position)
    omega = 2.0 * np.pi * factor * TONES
    angle = omega * run.time[:, None, None]
    velocity, acceleration = (omega * np.cos(angle)).sum(axis=2), -(omega**2 * np.sin(angle)).sum(axis=2)
    assert np.ptp(np.diff(run.time)) < 1e-9
    assert np.abs(run.velocity - velocity).max() < 5e-3 * np.abs(velocity).max()
    assert np.abs(run.acceleration - acceleration).max() < 5e-3 * np.abs(acceleration).max()
    assert run.parallel(run.torque)[:, 0] == pytest.approx(run.time[run.rows], abs=1e-3 / rate)
    assert run.reference == pytest.approx(np.sin(angle).sum(axis=2), abs=2e-3)


@pytest.mark.parametrize(("jitter", "lead"), [(0.2, 0.0), (0.0, 2e-3), (0.0, 0.0)])
def test_a_step_of_the_velocitys_sign_is_resampled_as_that_of_the_torque(jitter: float, lead: float) -> None:
    """With jittering or late stamps a torque of Coulomb friction is what the sign becomes, in each sample."""
    given = record(50.0, 30.0, jitter=jitter, factor=0.19)  # of which no sample lies at a reversal
    omega = 2.0 * np.pi * 0.19 * TONES
    velocity = (omega * np.cos(omega * (given.time - lead)[:, None, None])).sum(axis=2)
    (run,) = filter_record(replace(given, torque=np.sign(velocity)), Bandwidths(15.0, 5.0), torque_lead=lead)
    assert np.ptp(np.diff(run.time)) < 1e-9
    assert np.abs(run.evened(np.sign(run.torque_velocity)) - run.torque).max() < 1e-9
    assert run.evened(run.torque_velocity) == pytest.approx(run.velocity, abs=2e-3)
    assert (run.resampling is None) == (jitter == lead == 0.0)


def test_bandwidths_follow_the_noise_of_the_positions() -> None:
    """The noisier the positions, the less is let pass; never less than ten times the motion, and the user reads why."""
    chosen = [Bandwidths.of([record(500.0, 20.0, noise=noise)]) for noise in (1e-8, 1e-2)]
    assert 10.0 <= chosen[1].position / np.mean([2.0, 1.1]) < chosen[0].position / np.mean([2.0, 1.1]) <= 0.3 * 500.0
    assert all(one.torque == pytest.approx(one.position / 3.0) for one in chosen)
    assert f"{chosen[1].position:.3g} Hz" in chosen[1].reason
    slow = Bandwidths.of([record(67.0, 20.0, noise=1e-8, factor=3.0)])
    assert slow.position == pytest.approx(0.3 * 67.0)
    assert "no more than 0.3 of the sampling rate" in slow.reason
    given = [record(500.0, 200.0, noise=1e-8)] * 2
    long = Bandwidths.of(given)
    rows = sum(run.torque.shape[1] * len(run.rows) for one in given for run in filter_record(one, long))
    assert 25_000 < rows < 33_000
    assert "30000 rows" in long.reason
    assert Bandwidths.of([record(150.0, 300.0, noise=1e-8, factor=3.0)] * 2).torque == pytest.approx(13.5, rel=0.1)


def test_the_low_pass_ends_between_its_bandwidth_and_twice_that() -> None:
    """Its gain by the Fourier sum is 1 up to the bandwidth, a half at 1.5 times it, and -60 dB from twice it on."""
    taps = low_pass_taps(500.0, 20.0)
    place = np.arange(len(taps)) - len(taps) // 2
    gain = [taps @ np.cos(2.0 * np.pi * f / 500.0 * place) for f in (0.0, 20.0, 30.0, 40.0, 100.0)]
    assert gain == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0], abs=2e-3)


def test_what_cannot_be_filtered_is_refused() -> None:
    """Bandwidths beyond the rate, runs shorter than the filters' edges, and a recording at rest are refused."""
    with pytest.raises(
        IdentificationError, match=r"30 and 5 Hz at 50 samples per second; accepted: up to 22\.5 and 11"
    ):
        filter_record(record(50.0, 10.0), Bandwidths(30.0, 5.0))
    with pytest.raises(IdentificationError, match="no stretch of"):
        filter_record(record(50.0, 1.0), Bandwidths(2.0, 1.0))
    still = record(200.0, 5.0)
    quiet = replace(still, position=1e-5 * np.random.default_rng(1).normal(size=still.position.shape))
    with pytest.raises(IdentificationError, match="no joint moves"):
        Bandwidths.of([quiet])


def test_the_parallel_filter_is_a_convolution_at_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of any shape are low-passed by the run's symmetric taps at its rows, whole or block by block."""
    (run,) = runs_of(plain_arm(5, 2, coupled=False), 250.0, NOTHING, Bandwidths(40.0, 11.0))
    values = np.random.default_rng(2).normal(size=(len(run.time), 2, 3))
    assert run.down > 1
    assert np.array_equal(run.taps, run.taps[::-1])
    filtered = run.parallel(values)
    direct = np.convolve(values[:, 1, 2], run.taps, mode="same")[run.rows]
    assert filtered[:, 1, 2] == pytest.approx(direct, abs=1e-12)
    monkeypatch.setattr(filtering, "_BLOCK_SAMPLES", 500)
    parts = [run.parallel(values[samples]) for samples, _ in run.blocks()]
    assert len(parts) > 3
    assert [len(part) for part in parts] == [rows.stop - rows.start for _, rows in run.blocks()]
    assert np.concatenate(parts) == pytest.approx(filtered, abs=1e-12)


@pytest.mark.parametrize(("seed", "joints", "coupled"), [(3, 4, True), (5, 3, False)])
def test_exact_runs_give_back_every_base_parameter(seed: int, joints: int, coupled: bool, tmp_path: Path) -> None:
    """Without noise the base parameters are the groups of the true standard ones, and friction is the true one."""
    arm = plain_arm(seed, joints, coupled=coupled)
    runs = runs_of(arm, 400.0, NOTHING, Bandwidths(100.0, 20.0), periods=1)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs)
    fit, expected = solve(problem, all_columns(problem)), truth(problem, arm)
    assert fit.determined.all()
    assert undetermined(problem, fit) == ()
    assert fit.value == pytest.approx(expected, abs=2e-3 * float(np.abs(expected).max()))


def test_base_parameters_are_as_many_as_the_torque_tells(tmp_path: Path) -> None:
    """Their number is the rank of the columns by singular values, and their torque is that of all parameters."""
    arm = replace(plain_arm(7, 6, coupled=True), spring=np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0]))
    columns = StandardColumns(rigid_arm(arm, tmp_path))
    base = BaseGroups.of(columns)
    motion = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 80, 6))
    torque = columns.torque(*motion)
    values = np.linalg.svd(torque.reshape(-1, torque.shape[2]), compute_uv=False)
    assert len(base.leading) == int(np.sum(values > 1e-9 * values[0]))
    parameters = base.combination @ standard_values(arm)
    assert torque[:, :, base.leading] @ parameters == pytest.approx(arm.frictionless(*motion), abs=1e-8)


def test_rows_leave_out_pauses_and_keep_reversals(tmp_path: Path) -> None:
    """A joint's rows are missing where an element on it pauses, the coupled one among them; a reversal stays."""
    arm = plain_arm(4, 2, coupled=True)
    (run,) = runs_of(arm, 200.0, NOTHING, Bandwidths(40.0, 20.0))
    time = np.arange(len(run.time)) / 200.0
    # Joint 1 turns back at 2 s and pauses after 8 s; joint 2 undoes what joint 1 does from 4 to 6 s.
    rate = np.gradient(np.where(time < 8.0, np.cos(np.pi * np.minimum(time, 8.0) / 4.0), 1.0), time)
    velocity = np.column_stack([rate, np.where((time > 4.0) & (time < 6.0), -rate, 1.0)])
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), [replace(run, time=time, velocity=velocity)])
    there = [problem.time[problem.joint == joint] for joint in (0, 1)]
    for times in there:
        assert not np.any((times > 3.98) & (times < 6.02))  # as far as the low-pass of the torque reaches
    assert not np.any(there[0] > 8.0)
    assert np.any(there[1] > 8.5)
    turning = problem.time[problem.reversal & (problem.joint == 0) & (problem.time < 3.9)]
    assert np.all(np.abs(np.sin(np.pi * turning / 4.0)) < 0.1)


@pytest.mark.parametrize(
    ("velocity", "out"),
    [(lambda t: 2.0 * t**2, True), (lambda t: 0.9 * t**2 - 1.6 * t**3, True), (lambda t: 6.0 * (t + 1e-4), False)],
    ids=["stops and goes on", "stops, and turns back soon after", "turns back quickly"],
)
def test_a_stop_is_left_out_and_a_quick_reversal_is_not(velocity: Callable[[Array], Array], out: bool) -> None:
    """An element that stops without turning back has no known sign there, one that turns back between samples has."""
    (run,) = runs_of(plain_arm(5, 2, coupled=False), 60.0, NOTHING, Bandwidths(18.0, 6.0))
    time = np.arange(len(run.time)) / 60.0 - 5.0
    moved = replace(run, time=time, velocity=np.column_stack([velocity(time), 1.0 + 0.0 * time]))
    rests = element_states(moved, np.eye(2))[0][:, 0]
    assert rests[np.argmin(np.abs(time[run.rows]))] == out
    assert np.mean(rests) < 0.1


def test_instants_of_equal_phase_are_the_same_point_of_the_same_motion() -> None:
    """Periods of a run, and a run that is played again, share their phases; other motions have their own."""
    arm = random_arm(3, 2)
    twice = FourierMotion.random(arm, 1, period=6.0, periods=2, harmonics=3)
    motions = [FourierMotion.random(arm, 2, period=10.0, periods=1), twice, replace(twice, periods=1, rest=1.2)]
    runs, exact = [], []
    for number, motion in enumerate(motions):
        (filtered,) = filter_record(measured(arm, motion, 100.0, number, NOISE).record(arm), Bandwidths(25.0, 10.0))
        runs.append(filtered)
        exact.append(motion.at(filtered.time[filtered.rows])[0])
    (first, alone), (second, folded), (third, again) = phases(runs)
    assert (first, second, third) == (0, 1, 1)
    assert np.array_equal(alone, np.arange(len(alone)))
    period = round(6.0 * runs[1].rate / runs[1].down)
    assert set(folded.tolist()) == set(range(period))
    both, positions = np.concatenate([folded, again]), np.concatenate(exact[1:])
    moving = np.concatenate([np.abs(run.velocity[run.rows]).max(axis=1) > 0.3 for run in runs[1:]])
    widths = [np.ptp(positions[(both == phase) & moving], axis=0).max() for phase in set(both[moving].tolist())]
    assert len(widths) > 0.8 * period
    assert max(widths) < 0.15  # a row's time at some 3 rad/s


def test_what_is_no_repetition_is_not_taken_for_one() -> None:
    """Another motion of the smaller joint, another pace, and a tenth in common make another motion, 60 % does not."""
    rng = np.random.default_rng(0)
    waves = np.cumsum(rng.normal(size=(3000, 4)), axis=0)
    waves = np.sin(0.05 * (waves - np.linspace(0.0, 1.0, 3000)[:, None] * waves[-1]) + np.arange(4))
    size = np.array([2.0, 0.05])

    def run(velocity: Array, rate: float = 100.0) -> FilteredRun:
        time = np.arange(len(velocity)) / rate
        source = BagSource(Path("run"), "", float(time[-1]), 0, 0)
        bands = Bandwidths(25.0 * rate / 100.0, rate / 10.0)
        return FilteredRun(source, ("a", "b"), time, *([size * velocity] * 5), None, bands)

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
    assert [number for number, _ in found] == [0, 0, 1, 2, 3, 0]
    assert (found[1][1].min(), found[0][1].min()) == (0, 500 // given[0].down)


def test_a_motion_that_is_repeated_says_no_more_of_what_the_model_leaves_out(tmp_path: Path) -> None:
    """Deviations from a misfit alone are those of one recording however often it is repeated; noise averages out."""
    arm = random_arm(3, 2, stribeck=False)
    rigid = rigid_arm(arm, tmp_path, wrong=0.0)

    def deviation(disturbances: Disturbances, seeds: list[int]) -> Array:
        motion = FourierMotion.random(arm, 1, period=12.0, periods=1)
        records = [measured(arm, motion, 100.0, seed, disturbances).record(arm) for seed in seeds]
        problem = ExcitationProblem.of(
            rigid, [r for one in records for r in filter_record(one, Bandwidths(25.0, 10.0))]
        )
        return solve(problem, np.hstack([problem.regressor, coulomb_viscous(problem)])).deviation

    misfit, noise = replace(NOTHING, ripple=0.02, load=0.05), replace(NOTHING, white=0.3)
    assert deviation(misfit, [1, 1, 1, 1]) == pytest.approx(deviation(misfit, [1]), rel=0.05)
    averaged = deviation(noise, [1, 2, 3, 4]) / deviation(noise, [1])
    assert np.median(averaged) == pytest.approx(0.5, abs=0.15)
