"""A measured bag against the closed loop along its path: `rx.compare_measured`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.signal import resample_poly

import rx90_emulator as rx
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_emulator.loop.setup import Setup

STILL = 3  # the joint that rests: joint_4
MOVE = [k for k in range(6) if k != STILL]


@dataclass
class Measured:
    """A run of the engine, its bag, and its series."""

    folder: Path
    setup: Setup
    run: rx.RunResult
    bag: Path

    def write(self, name: str, series: rx.JointSeries, others: tuple[rx.JointSeries, ...] = ()) -> Path:
        """Write series as a bag."""
        rx.write_joint_states(self.folder / name, [series, *others])
        return self.folder / name

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
def measured(tmp_path_factory: pytest.TempPathFactory, shipped: Setup) -> Measured:
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
    """Return the setup with all friction torques times a factor."""
    values = {
        path: one.value * factor
        for path, one in rx.parameters(measured.setup).items()
        if path.startswith("friction.") and path.rpartition(".")[2].startswith(("tau_", "c2"))
    }
    return rx.with_parameters(measured.setup, values)


def test_the_engines_own_run_is_met(measured: Measured) -> None:
    """Along recorded set-points the same robot gives the bag's torques to 0.2 % and its positions to 5 urad."""
    result = rx.compare_measured(measured.bag, measured.setup)
    assert result.setpoints == "rx90_controller/reference in the bag"
    assert result.passed
    assert result.total_share < 2e-3
    assert np.nanmax(result.torque_share) < 5e-3
    assert result.position_worst.max() < 5e-6
    assert abs(result.lag) < 1e-5


def test_wrong_friction_shows_with_its_size(measured: Measured) -> None:
    """With 30 % more friction the verdict is no, and joint 1 differs by 0.3 times its steady friction torque."""
    result = rx.compare_measured(measured.bag, scaled(measured, 1.3))
    assert not result.passed
    assert result.total_share > result.tolerances.total_torque
    states = measured.run.series["joint_states"]
    speed = np.interp(result.time, states.time, np.asarray(states.velocity)[:, 0])
    fast = np.abs(speed) > 0.15
    more = 0.3 * measured.setup.friction.elements[0].steady_torque(speed[fast])
    found = (result.simulated_torque - result.torque)[fast, 0]
    np.testing.assert_allclose(found, more, atol=0.05 * np.abs(more).max())


@pytest.mark.parametrize("rate", [100, 1000, 5000])
def test_the_measured_path_does_without_set_points(measured: Measured, rate: int) -> None:
    """From positions and efforts at 100 Hz to 5 kHz torques of all joints agree within 5 %, and wrong ones do not."""
    bag = measured.write(f"joints_{rate}", measured.joints(rate))
    good = rx.compare_measured(bag, measured.setup)
    assert good.setpoints.startswith("the measured path below")
    assert good.passed
    assert good.total_share < 0.05
    if rate == 1000:
        assert not rx.compare_measured(bag, scaled(measured, 1.3)).passed


def test_the_layout_is_undone(measured: Measured) -> None:
    """Currents of reversed motors, zeros, other names and a late stamp in a bag change no figure by more than 1e-6."""
    motors = measured.run.series["motor_states"]
    plain = rx.compare_measured(measured.write("motors", motors), measured.setup)
    gear = np.array(measured.setup.drives.gear) * [1, -1, 1, 1, -1, 1]
    coupling = np.eye(6)
    coupling[5, 4] = 1.0
    was = np.asarray(measured.setup.drives.gear)[:, None] * coupling
    change = gear[:, None] * coupling @ np.linalg.inv(was)  # of motor positions
    zero = np.array([0.3, -1.0, 0.5, 2.0, 0.1, -0.2])
    constant = np.array([0.1, 0.2, 0.3, 0.1, 0.2, -0.1])
    other = replace(
        motors,
        topic="/arm/axes",
        names=tuple("uvwxyz"),
        stamp_ns=motors.stamp_ns + 1_700_000_000_000_000_000,
        position=np.asarray(motors.position) @ change.T + (gear[:, None] * coupling) @ zero,
        velocity=np.asarray(motors.velocity) @ change.T,
        effort=np.asarray(motors.effort) @ np.linalg.inv(change) / constant,
    )
    layout = rx.MeasuredLayout("arm/axes", "uvwxyz", gear, coupling.ravel(), constant, zero)
    changed = rx.compare_measured(measured.write("axes", other), measured.setup, layout)
    assert changed.time[0] > 1.6e9
    for name in ("torque_rms", "torque_share", "position_rms", "lag"):
        np.testing.assert_allclose(getattr(changed, name), getattr(plain, name), rtol=2e-3, atol=1e-6)


def test_a_table_of_motors_is_compared_as_their_bag(measured: Measured) -> None:
    """Motor angles and torques in an NPZ file, by a map beside it, give the bag's figures, set-points included."""
    motors, reference = measured.run.series["motor_states"], measured.run.series["rx90_controller/reference"]
    both = np.isin(motors.stamp_ns, reference.stamp_ns)
    bag = measured.write("some", motors.take(both), (reference,))
    arrays = {"t": motors.stamp_ns[both]}
    topics: dict[str, Any] = {}
    for series, topic in ((motors.take(both), "motor_states"), (reference, "rx90_controller/reference")):
        topics[topic] = {"names": list(series.names)}
        for field, unit in (("position", "rad"), ("velocity", "rad/s"), ("effort", "Nm")):
            if field in series.fields and not (series is reference and field == "effort"):
                arrays[f"{topic}_{field}".replace("/", "_")] = series.fields[field]
                columns = [f"{topic}_{field}[{k}]".replace("/", "_") for k in range(6)]
                topics[topic][field] = {"columns": columns, "unit": unit}
    np.savez(measured.folder / "log.npz", **arrays)
    content = {"time": {"column": "t", "unit": "ns"}, "topic": "motor_states", "topics": topics}
    (measured.folder / "log.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    table, plain = (rx.compare_measured(log, measured.setup) for log in (measured.folder / "log.npz", bag))
    assert table.setpoints == plain.setpoints == "rx90_controller/reference in the bag"
    np.testing.assert_array_equal(table.torque, plain.torque)
    np.testing.assert_array_equal(table.simulated_torque, plain.simulated_torque)


def test_a_delay_is_found_and_taken_out(measured: Measured) -> None:
    """States 8 ms later than in truth make the simulation 8 ms earlier, and the torques agree all the same."""
    states, reference = measured.joints(), measured.run.series["rx90_controller/reference"]
    late = replace(states, stamp_ns=states.stamp_ns + 8_000_000)
    result = rx.compare_measured(measured.write("late", late, (reference,)), measured.setup)
    assert result.lag == pytest.approx(-8e-3, abs=5e-5)
    assert result.total_share < 0.01


def test_what_is_beyond_the_band_or_at_rest_does_not_count(measured: Measured) -> None:
    """20 Nm of ripple at 400 Hz and 5 Nm on the joint at rest leave the figures; 5 Nm on a moving joint do not."""
    clean = rx.compare_measured(measured.write("clean", measured.joints()), measured.setup, bandwidth=60.0)
    assert np.isnan(clean.torque_rms[STILL])
    time, effort = measured.joints().time, np.array(measured.joints().effort)
    rippled = effort + 20.0 * np.sin(2.0 * np.pi * 400.0 * time)[:, None]
    rippled[:, STILL] += 5.0
    other = measured.write("ripple", measured.joints(effort=rippled))
    noisy = rx.compare_measured(other, measured.setup, bandwidth=60.0)
    np.testing.assert_allclose(noisy.torque_rms[MOVE], clean.torque_rms[MOVE], atol=0.05)
    pushed = measured.write("pushed", measured.joints(effort=effort + 5.0 * (np.arange(6) == 0)))
    wrong = rx.compare_measured(pushed, measured.setup, bandwidth=60.0)
    assert wrong.torque_rms[0] == pytest.approx(5.0, rel=0.1)


def test_a_bag_in_which_nothing_moves_is_refused(measured: Measured) -> None:
    """An arm that holds still has no torque to compare: refused before anything is simulated."""
    still = np.tile(np.asarray(measured.joints().position)[0], (len(measured.joints().time), 1))
    bag = measured.write("still", measured.joints(position=still, velocity=0.0 * still))
    with pytest.raises(IdentificationError, match="no joint moves"):
        rx.compare_measured(bag, measured.setup, bandwidth=60.0)


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


def test_the_longest_part_without_a_gap_is_compared(measured: Measured) -> None:
    """Where states are missing after half a second, what comes later is compared, and a remark says so."""
    states = measured.joints()
    kept = np.r_[0:500, 700 : len(states.stamp_ns)]
    parts = {name: np.asarray(getattr(states, name))[kept] for name in ("stamp_ns", "position", "velocity", "effort")}
    result = rx.compare_measured(measured.write("gap", replace(states, **parts)), measured.setup)
    assert result.time[0] > 0.7
    assert any("there are gaps in the record" in remark for remark in result.remarks)


def test_set_points_of_another_rate_and_zero_are_followed(measured: Measured) -> None:
    """Every second set-point, recorded with other zeros, is the same motion."""
    zero = np.array([0.3, -1.0, 0.5, 2.0, 0.1, -0.2])
    shifted = [
        replace(one, position=np.asarray(one.position) + zero)
        for one in (measured.joints(), measured.run.series["rx90_controller/reference"])
    ]
    fields = ("stamp_ns", "position", "velocity")
    sparse = replace(shifted[1], **{name: np.asarray(getattr(shifted[1], name))[::2] for name in fields}, effort=None)
    bag = measured.write("sparse", shifted[0], (sparse,))
    result = rx.compare_measured(bag, measured.setup, rx.MeasuredLayout(zero=zero))
    assert result.setpoints.startswith("rx90_controller/reference")
    assert result.total_share < 0.01
    assert result.passed
    for name in ("torque", "total_torque", "position"):  # each tolerance counts by itself
        assert not replace(result, tolerances=replace(result.tolerances, **{name: 1e-9})).passed
    with pytest.raises(IdentificationError, match="--bandwidth is 1000 Hz; accepted: above 0, up to 300 Hz"):
        rx.compare_measured(bag, measured.setup, rx.MeasuredLayout(zero=zero), bandwidth=1e3)


@pytest.mark.parametrize("said", ["have gaps", "are of different times"])
def test_set_points_that_cannot_be_followed_are_refused(measured: Measured, said: str) -> None:
    """A series with a hole, and one that was recorded at another time, are named."""
    series = measured.run.series["rx90_controller/reference"]
    fields = ("stamp_ns", "position", "velocity")
    kept = np.r_[0:100, 120 : len(series.stamp_ns)] if said == "have gaps" else np.arange(len(series.stamp_ns))
    parts = {name: np.asarray(getattr(series, name))[kept] for name in fields}
    if said != "have gaps":
        parts["stamp_ns"] = parts["stamp_ns"] + 1_000_000_000_000
    other = replace(series, **parts, effort=None)
    bag = measured.write(said.replace(" ", "_"), measured.joints(), (other,))
    with pytest.raises(IdentificationError, match=f"{said}"):
        rx.compare_measured(bag, measured.setup)
