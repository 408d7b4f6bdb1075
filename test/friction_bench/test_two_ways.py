"""Torque of both signs: the emulated rig through a reversal, friction of each direction, lag, loops, and refusals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rig_bench import greeted
from scipy.integrate import solve_ivp

from friction_bench.experiment import two_way
from friction_bench.experiment.job import SWING_TURNS, run_ramp
from friction_bench.experiment.record import RampRecord, read_csv, write_csv
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.messages import (
    Answer,
    Frame,
    HelloReply,
    RigRefusedError,
    encode,
    parse_hello,
)
from friction_bench.rig.plant import RigPlant, Shaft, turn
from friction_bench.rig.rig_file import JointFriction, Rig, load_rig
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import run

BIPOLAR_RIG = config_path("rig/bipolar.yaml")
JOINT = JointFriction(0.9, 0.11, 0.6, 0.18)
"""Coulomb and viscous friction of the joint, forward and backward."""


@pytest.fixture(scope="module")
def bipolar() -> Rig:
    """Return the shipped rig for torque of both signs."""
    return load_rig(BIPOLAR_RIG)


def two_signs(rig: Rig, **changes: Any) -> Rig:
    """Return the source's rig with a bipolar stage, a decoder and a joint that differs by direction."""
    return replace(rig, stage="bipolar", counts_down=True, plant=replace(rig.plant, joint=JOINT, **changes))


def friction_of(rig: Rig, backward: bool) -> tuple[float, float]:
    """Return what f_c and f_v at the motor are by hand: the motor's own, and the joint's through the gear."""
    coulomb, viscous = (0.6, 0.18) if backward else (0.9, 0.11)
    carried = rig.gear_ratio * rig.gear_efficiency
    return rig.plant.coulomb + coulomb / carried, rig.plant.viscous + viscous / (carried * rig.gear_ratio)


def test_a_shaft_turns_round_as_scipy_integrates_it(rig: Rig) -> None:
    """From +0.08 to -0.08 Nm and back an asymmetric joint slides, stops and slides the other way as equation 3 says."""
    quiet = two_signs(rig, gain_error=0.0, torque_noise=0.0)
    plant = RigPlant(quiet, 0)
    plant.load(True)
    p, n, eta = quiet.plant, quiet.gear_ratio, quiet.gear_efficiency
    inertia = p.rotor_inertia + (p.load_inertia + p.joint_inertia) / (n**2 * eta)
    state, found, expected = np.zeros(2), [], []
    for torque in (0.08, -0.08, -0.04, 0.09):
        for _ in range(60):
            plant.advance(torque, 1e-3)
            found.append((plant.angle, plant.speed))
        left, time = 0.06, 0.0
        at = np.arange(1, 61) * 1e-3
        rows = np.empty((60, 2))
        while left > 1e-12:  # from one stop to the next, where the sign of the friction changes
            sign = math.copysign(1.0, state[1]) if state[1] else math.copysign(1.0, torque)
            coulomb, viscous = friction_of(quiet, sign < 0.0)
            if state[1] == 0.0 and abs(torque) <= coulomb:
                rows[at > time] = state
                break

            def motion(_: float, y: Array, s: float = sign, c: float = coulomb, v: float = viscous) -> list[float]:
                return [y[1], (torque - s * c - v * y[1]) / inertia]  # noqa: B023 - used at once

            def stops(_: float, y: Array, s: float = sign) -> float:
                return s * y[1] + 1e-12

            stops.terminal, stops.direction = True, -1.0
            solved = solve_ivp(
                motion, (0.0, left), state, events=stops, rtol=1e-10, atol=1e-12, dense_output=True, max_step=1e-3
            )
            took = float(solved.t[-1])
            inside = (at > time) & (at <= time + took + 1e-12)
            rows[inside] = solved.sol(at[inside] - time).T
            state = solved.y[:, -1].copy()
            if solved.status == 1:
                state[1] = 0.0
            time, left = time + took, left - took
        expected.extend(rows.tolist())
    assert np.array(found) == pytest.approx(np.array(expected), rel=1e-6, abs=1e-6)
    speeds = np.array(found)[:, 1]
    assert speeds.max() > 10.0
    assert speeds.min() < -5.0


def test_back_emf_limits_torque_with_the_motion_and_not_against_it(rig: Rig) -> None:
    """At 500 rad/s forward 24 V leave (24 - 22.5) / 2.6 A for torque forward; torque backward has all that it asks."""
    plant = RigPlant(two_signs(rig, gain_error=0.0, torque_noise=0.0), 0)
    plant.speed = 500.0
    assert plant.motor_torque(0.15, 1e-3) == pytest.approx((24.0 - 0.045 * 500.0) / 2.6 * 0.045)
    assert plant.motor_torque(-0.15, 1e-3) == -0.15
    plant.speed = -500.0
    assert plant.motor_torque(-0.15, 1e-3) == pytest.approx(-(24.0 - 0.045 * 500.0) / 2.6 * 0.045)


@pytest.fixture(scope="module")
def asymmetric(rig: Rig) -> tuple[Rig, list[RampRecord]]:
    """Return a rig with an asymmetric joint and no error of its gain, and ramps and swings of it."""
    both = two_signs(rig, gain_error=0.0)
    client = greeted(both, 5, True)
    records = [
        run_ramp(client, slope, way * 0.15, True, f"{way} {slope} {k}")
        for way in (1.0, -1.0)
        for k in range(3)
        for slope in (0.02, 0.05)
    ]
    records += [run_ramp(client, 0.05, 0.15, True, f"swing {k}", turns=SWING_TURNS) for k in range(2)]
    assert client.lost_reports == 0
    return both, records


def test_friction_of_each_direction_lies_in_its_intervals(asymmetric: tuple[Rig, list[RampRecord]]) -> None:
    """By ramps and through zero the true f_c and f_v of both directions, and their differences, lie in the intervals.

    The intervals are no wider than a tenth of the differences, and no direction's holds the other direction's value.
    """
    rig, records = asymmetric
    found = two_way.evaluate_all(records, rig)
    assert found.failures == []
    truth = [friction_of(rig, backward) for backward in (False, True)]
    ramps = [side.parts[0][1].best for side in found.sides]
    swing = found.swings["loaded"]
    for friction, differences in ((ramps, found.differences["loaded"]), (swing.friction, swing.difference)):
        for index, name in enumerate(("coulomb", "viscous")):
            estimates = [getattr(one, name) for one in friction]
            for way, estimate in enumerate(estimates):
                assert estimate.low <= truth[way][index] <= estimate.high, name
                assert not estimate.low <= truth[1 - way][index] <= estimate.high, name
            difference = truth[0][index] - truth[1][index]
            assert differences[index].low <= difference <= differences[index].high
            assert differences[index].high - differences[index].low < 0.5 * abs(difference)


def test_lag_is_the_time_to_the_friction_of_the_new_direction(asymmetric: tuple[Rig, list[RampRecord]]) -> None:
    """A light shaft moves f_c / m after the torque's change of sign, in both directions."""
    rig, records = asymmetric
    swing = two_way.identify_swings([record for record in records if record.swing], rig.scale_uncertainty)
    assert sum(map(len, swing.times)) == 2 * SWING_TURNS
    slope = rig.slope_of_step(rig.ramp_step(0.05))
    for backward, found in zip((False, True), swing.lags, strict=True):
        assert found is not None
        lag, torque = found
        expected = friction_of(rig, backward)[0]
        assert lag.value == pytest.approx(expected / slope, abs=0.04)
        assert torque.value == pytest.approx(expected, abs=0.04 * slope)
        assert all(lag > 0.0 for some in swing.times for lag in some)


def test_lag_of_a_heavy_shaft_is_that_of_its_inertia() -> None:
    """Where inertia carries the shaft on, the lag is when the velocity of the analytic solution passes zero."""
    tick, slope, end, model = 0.02, 0.05, 0.15, (1e-6, 2e-3, 2e-3)
    coulomb, viscous, inertia = model
    torque = np.concatenate((np.arange(0.0, end, slope * tick), np.arange(end, -end, -slope * tick)))
    time = tick * np.arange(torque.size)

    def motion(t: float, y: Array) -> list[float]:
        held = torque[min(int(t / tick + 1e-9), torque.size - 1)]
        return [y[1], (held - viscous * y[1] - coulomb * math.tanh(y[1] * 1e6)) / inertia]

    solved = solve_ivp(motion, (0.0, time[-1]), [0.0, 0.0], t_eval=time, max_step=tick / 4, rtol=1e-8)
    step = math.tau / 10000
    record = RampRecord(
        time, np.floor(solved.y[0] / step) * step, slope, step, torque, loaded=True, label="heavy", swing=True
    )
    first, second = two_way.halves(record)
    assert not first.backward
    assert second.backward
    friction = two_way.RampFriction.of(np.array(model), np.eye(3) * 1e-12, 0.0)
    lag = two_way._lag(second, friction)
    falling = slice(np.argmax(torque) + 5, None)
    crossing = float(np.interp(0.0, -solved.y[1][falling], time[falling]))
    zero = float(np.interp(0.0, -torque[falling], time[falling])) + tick / 2
    assert lag == pytest.approx(crossing - zero, abs=tick)
    assert lag > 0.5  # J / f_v is 1 s


def test_a_swing_counts_as_one_run() -> None:
    """Where the torque is 2 % off from swing to swing, f_c has the standard error of so many swings, not stretches."""
    tick, slope, step = 0.02, 0.05, math.tau / 10000
    shaft, gains = Shaft(6e-5, 0.05, 1e-3), np.array([0.98, 1.0, 1.02])
    turning = np.cumsum(np.repeat([1.0, -1.0, 1.0, -1.0], [150, 300, 300, 150])) * slope * tick
    records = []
    for number, gain in enumerate(gains):
        angles, speed = [0.0], 0.0
        for torque in gain * turning[:-1]:
            angle, speed = turn(angles[-1], speed, float(torque), shaft, tick)
            angles.append(angle)
        angle = np.round(np.array(angles) / step) * step
        time = tick * np.arange(angle.size)
        records.append(RampRecord(time, angle, slope, step, turning, loaded=True, label=f"swing {number}", swing=True))
    for friction in two_way.identify_swings(records, 0.0).friction:
        expected = float(np.std(0.05 / gains, ddof=1)) / math.sqrt(3)
        assert friction.coulomb.value == pytest.approx(0.05, abs=2 * expected)
        assert friction.coulomb.error == pytest.approx(expected, rel=0.1)


def test_files_of_both_directions_come_back(asymmetric: tuple[Rig, list[RampRecord]], tmp_path: Path) -> None:
    """Written and read again, a ramp backward and a swing are the same, told by their signs alone."""
    rig, records = asymmetric
    for record in (records[0], records[7], records[-1]):
        write_csv(record, tmp_path / "ramp.csv")
        back = read_csv(tmp_path / "ramp.csv", record.slope, rig.angle_step, True)
        assert (back.backward, back.swing) == (record.backward, record.swing)
        for name in ("angle", "torque", "measured_torque"):
            assert getattr(back, name) == pytest.approx(getattr(record, name), abs=1e-9)
    raw = [float(line.split(",")[2]) for line in (tmp_path / "ramp.csv").read_text().splitlines()[2:]]
    assert min(raw) < 0.0 < max(raw)


def test_current_backward_is_measured_with_its_sign(asymmetric: tuple[Rig, list[RampRecord]]) -> None:
    """The ADC sees sizes; a swing's measured torque follows its command through both signs within noise and a step."""
    _, records = asymmetric
    swing = records[-1]
    off = swing.measured_torque[1:] - swing.torque[:-1]
    assert float(np.abs(off).mean()) < 0.003
    assert swing.measured_torque.min() < -0.14


def test_command_reports_both_directions(tmp_path: Path, check_report: Callable[[Path], None]) -> None:
    """`friction_ramp` on the shipped bipolar rig gives the joint's friction of each direction, difference and lag."""
    out = tmp_path / "out"
    words = ["--rig", "rig/bipolar.yaml", "--load", "joint", "--repeats", "2", "--slopes", "0.01", "0.025"]
    assert run("friction_ramp", [*words, "--output", str(out)]) == 0
    known = yaml.safe_load((out / "estimates.yaml").read_text())
    scale = load_rig(BIPOLAR_RIG).joint_scale
    for load in ("loaded, ramps", "loaded, through zero"):
        both = known["directions"][load]["coulomb"]
        assert both["forward"]["value"] * scale == pytest.approx(2.009, rel=0.02)
        assert both["backward"]["value"] * scale == pytest.approx(1.709, rel=0.02)
        low, high = both["difference"]["interval_95"]
        assert low < 0.3 / scale < high
    lags = known["lag_time_s"]["loaded"]
    assert [len(lags[way]) for way in ("forward", "backward")] == [4, 4]
    assert np.mean(lags["forward"]) > np.mean(lags["backward"]) > 1.7 / scale / 0.025
    element = yaml.safe_load((out / "friction.yaml").read_text())["elements"]["joint_6"]
    assert element["tau_c"]["positive"] - element["tau_c"]["negative"] == pytest.approx(0.3 / scale, rel=0.1)
    check_report(out / "report.html")
    page = (out / "report.html").read_text()
    assert "Both directions" in page
    assert "loaded, to backward:" in page
    torque = read_joint_states(out / "bag", "friction_bench/joint_commands").effort
    assert torque.min() < -0.12 < 0.12 < torque.max()


def test_a_firmware_of_version_1_is_named(rig: Rig) -> None:
    """The shorter greeting of the protocol's first version is understood as far as its version, and refused."""
    old = bytes.fromhex("01 01 01 f801 204e 204e a861 e5 07")
    hello = parse_hello(Frame(Answer.HELLO_REPLY, 7, old))
    assert isinstance(hello, HelloReply)
    assert hello.version == 1

    class Old(VirtualPort):
        def read(self, timeout: float) -> bytes:
            self.emulated.advance(timeout)
            return encode(Frame(Answer.HELLO_REPLY, 1, old))

    with pytest.raises(RigRefusedError, match="speaks protocol version 1; accepted: 2"):
        RigClient(Old(EmulatedRig(rig, 0)), rig).connect()
