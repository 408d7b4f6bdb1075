"""A measured bag against the closed loop along its path, by `rx.compare_measured` and the command."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, resample_poly, sosfiltfilt

import rx90_emulator as rx
from rx90_common.base.errors import DONE, REFUSED, VERDICT_NO, IdentificationError, TrajectoryError
from rx90_emulator.cli.frame import run
from rx90_emulator.measured_runs.compare import MeasuredComparison

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("undrawn")]

STILL = 3  # the joint that rests: joint_4
MOVE = [k for k in range(6) if k != STILL]


@dataclass
class Measured:
    folder: Path
    setup: rx.Setup
    run: rx.RunResult
    bag: Path

    def write(self, name: str, *series: rx.JointSeries) -> Path:
        rx.write_joint_states(self.folder / name, series)
        return self.folder / name

    def compare(self, name: str, *series: rx.JointSeries, **how: Any) -> MeasuredComparison:
        return rx.compare_measured(self.write(name, *series), self.setup, **how)

    def joints(self, rate: int = 1000, **changes: Any) -> rx.JointSeries:
        """Return the joint states at another rate, by SciPy's resampling, with changed fields."""
        series = self.run.series["joint_states"]
        values = {field: np.asarray(getattr(series, field)) for field in ("position", "velocity", "effort")}
        if rate != 1000:
            up, down = (rate // 1000, 1) if rate > 1000 else (1, 1000 // rate)
            values = {field: resample_poly(v, up, down, axis=0, padtype="line") for field, v in values.items()}
        stamps = np.arange(len(values["position"]), dtype=np.int64) * (1_000_000_000 // rate)
        return replace(series, stamp_ns=stamps, **(values | changes))


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory, shipped: rx.Setup) -> Measured:
    """Return three seconds in which joints 1 to 3, 5 and 6 turn back several times."""
    times = np.linspace(0.0, 3.0, 7)
    position = np.tile([0.0, 0.3, 0.9, 0.4, 0.5, 0.0], (7, 1))
    position[1:-1] += 0.12 * np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    position[:, STILL] = 0.4
    velocity = np.gradient(position, times, axis=0)
    velocity[[0, -1]] = 0.0
    points = rx.TrajectoryPoints(times, position, velocity, np.zeros_like(velocity))
    run = rx.simulate(shipped, points, duration=3.2, record_fast=True)
    folder = tmp_path_factory.mktemp("measured")
    rx.write_bag(run, folder / "own")
    return Measured(folder, shipped, run, folder / "own")


def scaled(measured: Measured, factor: float) -> rx.Setup:
    values = {
        path: one.value * factor
        for path, one in rx.parameters(measured.setup).items()
        if path.startswith("friction.") and path.rpartition(".")[2].startswith(("tau_", "c2"))
    }
    return rx.with_parameters(measured.setup, values)


def test_the_engines_own_run_is_met_and_wrong_friction_shows_with_its_size(measured: Measured) -> None:
    """Along recorded set-points the same robot gives the bag's torques to 0.2 % and its positions to 5 urad."""
    result = rx.compare_measured(measured.bag, measured.setup, bandwidth=120.0)
    assert result.setpoints == "rx90_controller/reference in the bag"
    assert result.passed
    assert result.torque.total_share < 2e-3
    assert np.nanmax(result.torque.rms_share) < 5e-3
    assert result.position_worst.max() < 5e-6
    assert abs(result.lag) < 1e-5
    wrong = rx.compare_measured(measured.bag, scaled(measured, 1.3))
    assert not wrong.passed
    assert wrong.torque.total_share > wrong.tolerances.total_torque
    states = measured.run.series["joint_states"]
    speed = np.interp(wrong.torque.time, states.time, np.asarray(states.velocity)[:, 0])
    fast = np.abs(speed) > 0.15
    more = 0.3 * measured.setup.friction.elements[0].steady_torque(speed[fast])
    found = (wrong.torque.predicted - wrong.torque.recorded)[fast, 0]
    np.testing.assert_allclose(found, more, atol=0.05 * np.abs(more).max())


@pytest.mark.parametrize("rate", [100, 1000, 5000])
def test_the_measured_path_does_without_set_points(measured: Measured, rate: int) -> None:
    """From positions and efforts at 100 Hz to 5 kHz torques of all joints agree within 5 %, and wrong ones do not."""
    bag = measured.write(f"joints_{rate}", measured.joints(rate))
    good = rx.compare_measured(bag, measured.setup)
    assert good.setpoints.startswith("the measured path below")
    # No set-point, those on the way to the begin of the path included, is beyond a limit.
    assert not any("needs the" in remark for remark in good.remarks)
    assert good.passed
    assert good.torque.total_share < 0.05
    if rate == 1000:
        assert not rx.compare_measured(bag, scaled(measured, 1.3)).passed


def test_torques_are_compared_below_their_smoothing(measured: Measured) -> None:
    """At 4 kHz as at 1 kHz: of torques behind a zero-phase low-pass of 20 Hz, nothing beyond it tells of the arm."""
    torque, low_pass = np.asarray(measured.joints(4000).effort), butter(2, 20.0, fs=4000, output="sos")
    smooth = measured.compare("smooth", measured.joints(4000, effort=sosfiltfilt(low_pass, torque, axis=0)))
    assert smooth.bandwidths.torque < 20.0
    assert smooth.torque.total_share < 0.04  # up to 100 Hz it is 0.06


def test_a_delay_and_a_gap_are_found(measured: Measured) -> None:
    """States 8 ms later than in truth make the simulation 8 ms earlier, and the torques agree all the same."""
    states, reference = measured.joints(), measured.run.series["rx90_controller/reference"]
    late = measured.compare("late", replace(states, stamp_ns=states.stamp_ns + 8_000_000), reference)
    assert late.lag == pytest.approx(-8e-3, abs=5e-5)
    assert late.torque.total_share < 0.01
    kept = np.r_[0:500, 700 : len(states.stamp_ns)]
    parts = {name: np.asarray(getattr(states, name))[kept] for name in ("stamp_ns", "position", "velocity", "effort")}
    result = measured.compare("gap", replace(states, **parts))
    assert result.torque.time[0] > 0.7
    assert any("there are gaps in the record" in remark for remark in result.remarks)


def test_what_is_beyond_the_band_or_at_rest_does_not_count(measured: Measured) -> None:
    """20 Nm of ripple at 400 Hz and 5 Nm on the joint at rest leave the figures; 5 Nm on a moving joint do not."""
    clean = measured.compare("clean", measured.joints(), bandwidth=60.0)
    assert np.isnan(clean.torque.rms[STILL])
    time, effort = measured.joints().time, np.array(measured.joints().effort)
    rippled = effort + 20.0 * np.sin(2.0 * np.pi * 400.0 * time)[:, None]
    rippled[:, STILL] += 5.0
    noisy = measured.compare("ripple", measured.joints(effort=rippled), bandwidth=60.0)
    np.testing.assert_allclose(noisy.torque.rms[MOVE], clean.torque.rms[MOVE], atol=0.05)
    pushed = measured.joints(effort=effort + 5.0 * (np.arange(6) == 0))
    wrong = measured.compare("pushed", pushed, bandwidth=60.0)
    assert wrong.torque.rms[0] == pytest.approx(5.0, rel=0.1)


def test_a_path_beyond_the_limits_is_named(measured: Measured) -> None:
    """A position beyond the range is refused with joint, value and time; too fast an acceleration is a remark."""
    low = np.array(measured.setup.robot.lower)
    low[1] = 0.25
    bag = measured.write("limits", measured.joints())
    position = np.asarray(measured.run.series["joint_states"].position)[:, 1]
    narrow = replace(measured.setup, robot=replace(measured.setup.robot, lower=low))
    with pytest.raises(TrajectoryError, match=r"joint_2 needs the position (\S+) rad at (\S+) s; accepted") as caught:
        rx.compare_measured(bag, narrow)
    words = str(caught.value).split()
    assert float(words[words.index("position") + 1]) == pytest.approx(position.min(), abs=1e-3)
    assert float(words[words.index("at") + 1]) == pytest.approx(position.argmin() * 1e-3, abs=0.02)
    slow = rx.with_parameters(measured.setup, {"controller.max_acceleration[*]": 0.3})
    assert any("needs the acceleration" in remark for remark in rx.compare_measured(bag, slow).remarks)


def test_set_points_of_another_rate_and_zero_are_followed(measured: Measured) -> None:
    """Every second set-point, recorded with other zeros, is the same motion."""
    zero = np.array([0.3, -1.0, 0.5, 2.0, 0.1, -0.2])
    shifted = [
        replace(one, position=np.asarray(one.position) + zero)
        for one in (measured.joints(), measured.run.series["rx90_controller/reference"])
    ]
    fields = ("stamp_ns", "position", "velocity")
    sparse = replace(shifted[1], **{name: np.asarray(getattr(shifted[1], name))[::2] for name in fields}, effort=None)
    bag = measured.write("sparse", shifted[0], sparse)
    result = rx.compare_measured(bag, measured.setup, rx.MeasuredLayout(zero=zero))
    assert result.setpoints.startswith("rx90_controller/reference")
    assert result.torque.total_share < 0.01
    assert result.passed
    for name in ("torque", "total_torque", "position"):  # each tolerance counts by itself
        assert not replace(result, tolerances=replace(result.tolerances, **{name: 1e-9})).passed
    with pytest.raises(IdentificationError, match="--bandwidth is 1000 Hz; accepted: above 0, up to 300 Hz"):
        rx.compare_measured(bag, measured.setup, rx.MeasuredLayout(zero=zero), bandwidth=1e3)


@pytest.mark.parametrize("said", ["have gaps", "have no time in common", "no joint moves"])
def test_what_cannot_be_followed_is_refused(measured: Measured, said: str) -> None:
    """Set-points with a hole, those that were recorded at another time, and an arm that holds still are named."""
    series, joints = measured.run.series["rx90_controller/reference"], measured.joints()
    kept = np.r_[0:100, 120 : len(series.stamp_ns)] if said == "have gaps" else np.arange(len(series.stamp_ns))
    parts = {name: np.asarray(getattr(series, name))[kept] for name in ("stamp_ns", "position", "velocity")}
    if said == "have no time in common":
        parts["stamp_ns"] = parts["stamp_ns"] + 1_000_000_000_000
    if said == "no joint moves":
        still = np.tile(np.asarray(joints.position)[0], (len(joints.time), 1))
        joints = measured.joints(position=still, velocity=0.0 * still)
    bag = measured.write(said.replace(" ", "_"), joints, replace(series, **parts, effort=None))
    with pytest.raises(IdentificationError, match=said):
        rx.compare_measured(bag, measured.setup, bandwidth=60.0)


def test_the_verdict_is_the_exit_code(
    measured: Measured, tmp_path: Path, capsys: pytest.CaptureFixture[str], check_report: Callable[[Path], None]
) -> None:
    """0 for the robot that ran, 1 for tolerances that it cannot keep; a page says so and is not replaced unasked."""
    page = tmp_path / "page.html"
    assert run("rx90 identify compare", [str(measured.bag), "--report", str(page)]) == DONE
    said = capsys.readouterr().out
    assert ": agrees: torque RMS of all joints 0." in said
    assert [line.split()[0] for line in said.splitlines() if line.startswith("joint_")] == [
        f"joint_{k}" for k in range(1, 7)
    ]
    text = page.read_text(encoding="utf-8")
    assert "<b>agrees</b>" in text
    assert text.count('<figure class="plot') == 2
    assert run("rx90 identify compare", [str(measured.bag), "--report", str(page)]) == REFUSED
    assert "exists; accepted: another name, or --force" in capsys.readouterr().err
    assert run("rx90 identify compare", [str(measured.bag), "--position-tolerance", "1e-12"]) == VERDICT_NO
    assert "DOES NOT AGREE" in capsys.readouterr().out
    check_report(page)
