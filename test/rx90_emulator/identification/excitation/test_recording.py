"""What recordings do to an identification: jitter, resampling, gaps, shocks, smoothed torques, low rates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import Array, all_columns, plain_arm, rigid_arm, truth
from scipy.signal import butter, sosfiltfilt

from benchmarks.excitation_runs import NOISE, NOTHING, Disturbances, FourierMotion, measured
from benchmarks.random_arms import SyntheticArm
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.bandwidths import choose_bandwidths
from rx90_emulator.identification.excitation.filtering import (
    Bandwidths,
    filter_record,
    least_bandwidth,
    recording_notes,
    smoothed_above,
    without_shocks,
)
from rx90_emulator.identification.excitation.fit import LinearFit, solve
from rx90_emulator.identification.excitation.identify import log_warnings
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.records import JointRecord

pytestmark = pytest.mark.slow

ARM = plain_arm(7, 2, coupled=False)
RATE = 500.0
Equations = Callable[[Sequence[JointRecord], Bandwidths], ExcitationProblem]


@pytest.fixture(scope="module")
def equations(tmp_path_factory: pytest.TempPathFactory) -> Equations:
    """Return what makes equations of records of the arm."""
    known = rigid_arm(ARM, tmp_path_factory.mktemp("arm"))
    return lambda some, bandwidths: ExcitationProblem.of(
        known, [run for one in some for run in filter_record(one, bandwidths)]
    )


def recorded(
    disturbances: Disturbances = NOISE, rate: float = RATE, seed: int = 0, arm: SyntheticArm = ARM
) -> JointRecord:
    """Return a run of 25 s."""
    return measured(arm, FourierMotion.random(arm, seed), rate, seed, disturbances).record(arm)


def fitted(problem: ExcitationProblem) -> LinearFit:
    """Return base parameters, Coulomb and viscous friction."""
    return solve(problem, all_columns(problem))


def resampled(record: JointRecord) -> JointRecord:
    """Return a record as a user evens it: linearly, the motion without what lies above 60 Hz."""
    time = np.arange(record.time[0], record.time[-1], 1.0 / RATE)

    def even(values: Array) -> Array:
        return np.column_stack([np.interp(time, record.time, column) for column in values.T])

    sections = butter(4, 60.0, fs=RATE, output="sos")
    position, velocity = (sosfiltfilt(sections, even(values), axis=0) for values in (record.position, record.velocity))
    return JointRecord(record.names, time, position, velocity, even(record.torque), record.source, record.sha256)


def test_jittering_stamps_and_the_same_log_resampled_give_the_same_values(equations: Equations) -> None:
    """Values of both lie within three deviations; where the spectrum asks for too much, prediction takes less."""
    jittering = replace(recorded(Disturbances(jitter=0.05, stamp=2e-4)), no_velocity="none")
    even = resampled(jittering)
    (own, first), (chosen, second) = (choose_bandwidths([one], equations) for one in (jittering, even))
    one, other = fitted(first), fitted(second)
    apart = np.abs(one.value - other.value) / np.maximum(one.deviation, other.deviation)
    assert np.max(apart) < 3.0
    asked = Bandwidths.of([even])
    wide = fitted(equations([even], asked))
    values = truth(second, ARM)
    assert chosen.position < 0.5 * asked.position
    assert np.linalg.norm((wide.value - values) / other.deviation) > 2.0 * np.linalg.norm(
        (other.value - values) / other.deviation
    )
    assert own.position >= least_bandwidth([jittering])
    assert f"the positions get {chosen.position:.3g} Hz" in chosen.reason
    assert second.runs[0].bandwidths == chosen


def test_a_bandwidth_without_noise_stays_and_a_given_one_is_taken(equations: Equations) -> None:
    """Where narrower bandwidths predict no better, the spectrum's is kept; a user's comes first, and 0 is refused."""
    record = recorded(NOTHING)
    chosen, _ = choose_bandwidths([record], equations)
    assert chosen[:2] == Bandwidths.of([record])[:2]
    given, problem = choose_bandwidths([record], equations, 12.0)
    assert given == Bandwidths(12.0, 4.0)
    assert problem.runs[0].bandwidths == given
    with pytest.raises(IdentificationError, match="--bandwidth is 0 Hz; accepted: a number of at least 1e-06"):
        choose_bandwidths([record], equations, 0.0)


def test_recorded_velocities_are_used_where_they_predict_better(equations: Equations) -> None:
    """Exact velocities beside noisy positions are used; noisy ones beside exact positions are not."""
    exact, rng = recorded(NOTHING), np.random.default_rng(0)
    motion = FourierMotion.random(ARM, 0).at(exact.time)
    coarse = replace(
        exact, position=motion[0] + 0.01 * rng.normal(size=motion[0].shape), velocity=motion[1], no_velocity=""
    )
    noisy = replace(exact, velocity=motion[1] + 0.3 * rng.normal(size=motion[1].shape), no_velocity="")
    used, unused = (choose_bandwidths([one], equations)[0] for one in (coarse, noisy))
    assert used.recorded_velocity
    assert not unused.recorded_velocity
    assert "differences are used" in unused.reason
    assert "for none were recorded" in choose_bandwidths([exact], equations)[0].reason


def test_a_short_gap_is_bridged_and_counted_and_a_long_one_splits() -> None:
    """Three gaps of 12 ms leave one run with the motion that it has without them, and are said; 0.3 s splits it."""
    record = recorded()
    bands = Bandwidths(10.0, 3.0)

    def holed(width: float, *centres: float) -> JointRecord:
        kept = np.all([np.abs(record.time - record.time[0] - one) > 0.5 * width for one in centres], axis=0)
        position, velocity, torque = (values[kept] for values in (record.position, record.velocity, record.torque))
        return JointRecord(record.names, record.time[kept], position, velocity, torque, Path("log"), "0")

    short, long = holed(0.012, 5.0, 10.0, 15.0), holed(0.3, 10.0)
    (whole,) = filter_record(record, bands)
    (run,) = filter_record(short, bands)
    for name in ("position", "velocity", "acceleration"):
        values, other = getattr(whole, name), getattr(run, name)
        there = [np.interp(whole.time, run.time, column) for column in other.T]
        assert np.column_stack(there)[50:-50] == pytest.approx(values[50:-50], abs=0.02 * np.abs(values).max())
    filtered, bridged = (one.parallel(one.torque) for one in (whole, run))
    there = [np.interp(whole.time[whole.rows], run.time[run.rows], column) for column in bridged.T]
    assert np.column_stack(there)[1:-1] == pytest.approx(filtered[1:-1], abs=0.02 * np.abs(filtered).max())
    first, second = filter_record(long, bands)
    before, after = np.array([first.time[-1], second.time[0]]) - record.time[0] - 10.0
    assert before < -0.15
    assert after > 0.15
    assert recording_notes([short], bands)[0].startswith("log: 3 gaps of up to 14")
    assert "log: 1 gap of up to 0.304 s split the run" in recording_notes([long], bands)[0]
    assert recording_notes([record], bands) == ()


SHOCKS = ((3.3, 0, 80.0), (8.1, 1, -60.0), (13.7, 0, -80.0), (19.2, 1, 60.0))  # s, joint, Nm


def shocked(record: JointRecord) -> JointRecord:
    """Return a record with pulses of 12 ms in its torque."""
    torque = record.torque.copy()
    for begin, joint, size in SHOCKS:
        torque[(record.time >= begin) & (record.time < begin + 0.012), joint] += size
    return replace(record, torque=torque)


def test_shocks_are_found_where_they_are_and_nowhere_else() -> None:
    """Four pulses of 12 ms are found to some 10 ms; clean runs of six arms have none."""
    for seed in range(6):
        arm = plain_arm(seed, 3, coupled=seed % 2 == 0)
        clean = recorded(NOISE if seed % 3 else NOTHING, 250.0 * (1 + seed % 3), seed, arm)
        assert without_shocks(clean, np.eye(3))[1] == ()
    found, (text,) = without_shocks(shocked(recorded()), np.eye(2))
    assert len(found.shocks) == len(SHOCKS)
    for (begin, end), (true, _, _) in zip(found.shocks, SHOCKS, strict=True):
        assert true - 0.015 < begin < true < true + 0.012 < end < true + 0.027
    assert "4 shocks of the torque left out" in text


def test_values_beside_shocks_are_those_of_the_clean_run(equations: Equations) -> None:
    """With the shocks left out values lie near those of the clean run, nearer by far than with them."""
    clean, bands = recorded(), Bandwidths(7.5, 2.5)
    found, _ = without_shocks(shocked(clean), np.eye(2))
    true, left, there = (fitted(equations([one], bands)) for one in (clean, found, shocked(clean)))
    apart = [np.abs(one.value - true.value) / true.deviation for one in (left, there)]
    assert apart[0].max() < 0.7
    assert apart[1].max() > 3.0 * apart[0].max()


def smoothed(record: JointRecord, order: int) -> JointRecord:
    """Return a record whose torque passed a zero-phase Butterworth low-pass of 5 Hz."""
    rate = (len(record.time) - 1) / (record.time[-1] - record.time[0])
    return replace(record, torque=sosfiltfilt(butter(order, 5.0, fs=rate, output="sos"), record.torque, axis=0))


@pytest.mark.parametrize("rate", [100.0, 500.0])
@pytest.mark.parametrize("order", [2, 4])
def test_smoothed_torques_are_noticed_and_identified(rate: float, order: int, equations: Equations) -> None:
    """Torques behind a zero-phase low-pass of 5 Hz get a bandwidth below it, and give values near the true ones."""
    record = smoothed(recorded(rate=rate), order)
    chosen, problem = choose_bandwidths([record], equations)
    assert 1.0 < chosen.torque < 4.0
    assert "smoothed before" in chosen.reason
    assert "smoothed before" in recording_notes([record], chosen)[-1]
    fit, values = fitted(problem), truth(problem, ARM)
    explained = all_columns(problem) @ (fit.value - values)
    assert np.linalg.norm(explained) < 0.03 * np.linalg.norm(problem.torque)
    friction = slice(len(problem.names), None, 2)
    assert fit.value[friction] == pytest.approx(values[friction], rel=0.1)


def test_measured_torques_are_not_smoothed() -> None:
    """Noise or the steps of friction keep a torque's spectrum from falling as a low-pass does."""
    for seed in range(4):
        arm = plain_arm(seed, 3, coupled=False)
        assert smoothed_above([recorded(NOISE if seed % 2 else NOTHING, 200.0, seed, arm)]) is None


def test_slow_and_short_logs_carry_a_warning(equations: Equations) -> None:
    """At 40 samples per second, and with fewer instants than parameters, a warning says what that does not tell."""
    slow = recorded(rate=40.0)
    (note,) = recording_notes([slow], Bandwidths(10.0, 3.0))
    assert note.startswith("warning: ")
    assert "40 samples per second do not resolve motion above 12 Hz" in note
    assert log_warnings(equations([slow], Bandwidths(10.0, 3.0))) == []
    few = replace(slow, **{name: getattr(slow, name)[:280] for name in ("time", "position", "velocity", "torque")})
    (note,) = log_warnings(equations([few], Bandwidths(5.0, 1.5)))
    assert "warning: a short log" in note
