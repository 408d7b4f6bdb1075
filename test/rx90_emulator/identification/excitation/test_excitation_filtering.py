"""Filtering of excitation runs against analytic motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record, low_pass_taps
from rx90_emulator.identification.records import JointRecord

TONES = ((0.7, 0.3), (2.0, 1.1))  # Hz of each joint


def record(
    rate: float, seconds: float, *, jitter: float = 0.0, noise: float = 0.0, gap: float = 0.0, factor: float = 1.0
) -> JointRecord:
    """Return two joints that swing with two tones each; torque is a ramp."""
    rng = np.random.default_rng(0)
    time = np.arange(round(seconds * rate)) / rate
    time = time + jitter / rate * rng.uniform(-1.0, 1.0, len(time))
    if gap:
        time = time[np.abs(time - 0.5 * seconds) > 0.5 * gap]
    angle = 2.0 * np.pi * factor * np.array(TONES) * time[:, None, None]
    position = np.sin(angle).sum(axis=2) + noise * rng.normal(size=(len(time), 2))
    torque = np.column_stack([time, -time])
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
    omega = 2.0 * np.pi * factor * np.array(TONES)
    angle = omega * run.time[:, None, None]
    velocity = (omega * np.cos(angle)).sum(axis=2)
    acceleration = -(omega**2 * np.sin(angle)).sum(axis=2)
    assert np.ptp(np.diff(run.time)) < 1e-9
    assert np.abs(run.velocity - velocity).max() < 5e-3 * np.abs(velocity).max()
    assert np.abs(run.acceleration - acceleration).max() < 5e-3 * np.abs(acceleration).max()
    assert run.parallel(run.torque)[:, 0] == pytest.approx(run.time[run.rows], abs=1e-3 / rate)
    assert run.reference == pytest.approx(np.sin(angle).sum(axis=2), abs=2e-3)


@pytest.mark.parametrize(("jitter", "lead"), [(0.2, 0.0), (0.0, 2e-3), (0.0, 0.0)])
def test_a_step_of_the_velocitys_sign_is_resampled_as_that_of_the_torque(jitter: float, lead: float) -> None:
    """With jittering or late stamps a torque of Coulomb friction is what the sign becomes, in each sample."""
    given = record(50.0, 30.0, jitter=jitter, factor=0.19)  # of which no sample lies at a reversal
    omega = 2.0 * np.pi * 0.19 * np.array(TONES)
    velocity = (omega * np.cos(omega * (given.time - lead)[:, None, None])).sum(axis=2)
    (run,) = filter_record(replace(given, torque=np.sign(velocity)), Bandwidths(15.0, 5.0), torque_lead=lead)
    assert np.ptp(np.diff(run.time)) < 1e-9
    assert np.abs(run.evened(np.sign(run.torque_velocity)) - run.torque).max() < 1e-9
    assert run.evened(run.torque_velocity) == pytest.approx(run.velocity, abs=2e-3)
    assert (run.stamps is None) == (jitter == lead == 0.0)


def test_a_gap_begins_a_new_run() -> None:
    """Where 0.3 s are missing, one run ends and another begins; neither times nor the rate go across."""
    first, second = filter_record(record(200.0, 12.0, gap=0.3), Bandwidths(0.449 * 200.0, 20.0))
    assert first.time[-1] < 5.85
    assert second.time[0] > 6.15


def test_bandwidths_follow_the_noise_of_the_positions() -> None:
    """The noisier the positions, the less is let pass; never less than ten times the motion, and the user reads why."""
    chosen = [Bandwidths.of([record(500.0, 20.0, noise=noise)]) for noise in (1e-8, 1e-2)]
    assert 10.0 <= chosen[1].position / np.mean([2.0, 1.1]) < chosen[0].position / np.mean([2.0, 1.1]) <= 0.3 * 500.0
    assert all(one.torque == pytest.approx(one.position / 3.0) for one in chosen)
    assert f"{chosen[1].position:.3g} Hz" in chosen[1].reason
    slow = Bandwidths.of([record(67.0, 20.0, factor=3.0)])
    assert slow.position == pytest.approx(0.3 * 67.0)
    assert "no more than 0.3 of the sampling rate" in slow.reason


def test_the_low_pass_ends_between_its_bandwidth_and_twice_that() -> None:
    """Its gain by the Fourier sum is 1 up to the bandwidth, a half at 1.5 times it, and -60 dB from twice it on."""
    taps = low_pass_taps(500.0, 20.0)
    place = np.arange(len(taps)) - len(taps) // 2
    gain = [taps @ np.cos(2.0 * np.pi * f / 500.0 * place) for f in (0.0, 20.0, 30.0, 40.0, 100.0)]
    assert gain == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0], abs=2e-3)


@pytest.mark.parametrize(
    ("given", "bandwidths", "said"),
    [
        (
            record(50.0, 10.0),
            Bandwidths(30.0, 5.0),
            "30 and 5 Hz at 50 samples per second; accepted: up to 22.5 and 11",
        ),
        (record(50.0, 1.0), Bandwidths(2.0, 1.0), "no stretch of"),
    ],
    ids=["too fast for the rate", "too short"],
)
def test_what_cannot_be_filtered_is_refused(given: JointRecord, bandwidths: Bandwidths, said: str) -> None:
    """Bandwidths beyond the rate, and runs shorter than the filters' edges, are refused in one line."""
    with pytest.raises(IdentificationError, match=said):
        filter_record(given, bandwidths)


def test_a_recording_at_rest_is_refused() -> None:
    """Where no joint moves there is nothing to choose a bandwidth from."""
    still = record(200.0, 5.0)
    rng = np.random.default_rng(1)
    quiet = JointRecord(
        still.names, still.time, 1e-5 * rng.normal(size=still.position.shape), still.velocity, still.torque,
        Path("rest"), "0",
    )  # fmt: skip
    with pytest.raises(IdentificationError, match="no joint moves"):
        Bandwidths.of([quiet])


def test_long_quiet_runs_keep_no_more_rows_than_a_fit_needs() -> None:
    """Of runs without noise the torque's bandwidth falls until some 30,000 rows are left, and the user reads why.

    Of a faster motion, of 2.1 and 6 Hz, it keeps a third of ten times their middle.
    """
    given = [record(500.0, 200.0, noise=1e-8)] * 2
    chosen = Bandwidths.of(given)
    rows = sum(run.torque.shape[1] * len(run.rows) for one in given for run in filter_record(one, chosen))
    assert 25_000 < rows < 33_000
    assert "30000 rows" in chosen.reason
    assert Bandwidths.of([record(150.0, 300.0, factor=3.0)] * 2).torque == pytest.approx(13.5, rel=0.1)


def test_a_torque_that_acted_before_its_stamp_is_put_back() -> None:
    """A ramp whose values are those of an instant 0.4 ms earlier comes out as that of its own time."""
    given = record(1000.0, 6.0)
    late = replace(given, torque=given.torque - 4e-4 * np.array([1.0, -1.0]))
    (run,) = filter_record(late, Bandwidths(40.0, 20.0), torque_lead=4e-4)
    assert run.parallel(run.torque)[:, 0] == pytest.approx(run.time[run.rows], abs=1e-6)
