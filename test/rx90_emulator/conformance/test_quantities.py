"""What the controller check measures, against records whose quantities are known."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from rx90_common.base.arrays import Array
from rx90_emulator.conformance.battery import CASES, START, Case, Nominal, Record, make_case, run_cs7b, set_points
from rx90_emulator.conformance.quantities import QUANTITIES, CheckLimits, Loop, judge, loops, measure, oscillation
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup


@pytest.fixture
def nominal(shipped: Setup, tmp_path: Path) -> Nominal:
    """Return what cases are made of, with the CS7B's torques."""
    return Nominal(shipped, tmp_path, lambda case: np.asarray(np.abs(run_cs7b(case, shipped).sent).max(axis=0)))


def record_of(case: Case, position: Array, sent: Array | None = None) -> Record:
    """Return the record of a run in which the arm took these positions, and these torques were commanded."""
    record, drives = Record(case), case.setup.drives
    motors = position @ drives.turning.turns.T * drives.gear
    for tick in range(case.ticks):
        record.note_states(tick, motors[tick])
        record.carry(tick, np.zeros(6) if sent is None else sent[tick])
    return record


def test_margins_are_those_of_the_loop_that_answered(nominal: Nominal) -> None:
    """Answers of a known loop to the sines give its margins: gain 20 dB and phase by their equations, at 10 %."""
    case = make_case("sweep", nominal)
    assert case.sines is not None
    crossover, lag, delay = 90.0, 1.0 / 2500.0, 0.5e-3

    def opened(frequency: Array) -> Array:
        s = 2j * np.pi * frequency
        return np.asarray(2.0 * np.pi * crossover / s / (1.0 + lag * s) * np.exp(-delay * s))

    since = case.times[:, None, None] - case.sines.begin
    loop = opened(case.sines.frequency)
    answer = -loop / (1.0 + loop) * np.exp(1j * case.sines.phase)
    waves = (np.exp(2j * np.pi * since * case.sines.frequency) * answer).imag.sum(axis=2)
    sent = case.sines.amplitude * waves + np.linspace(0.0, 30.0, case.ticks)[:, None]  # the weight, as the arm moves
    measured = loops(record_of(case, np.zeros((case.ticks, 6)), sent))

    def phase(frequency: float) -> float:
        return 90.0 + math.degrees(math.atan(2 * math.pi * frequency * lag) + 2 * math.pi * frequency * delay)

    at_gain_1 = brentq(lambda f: abs(opened(np.array([f]))[0]) - 1.0, 1.0, 500.0)
    at_half_turn = brentq(lambda f: phase(f) - 180.0, 10.0, 900.0)
    gain = -20.0 * math.log10(abs(opened(np.array([at_half_turn]))[0]))
    for one in measured:
        assert one.gain == pytest.approx(opened(one.frequency), rel=0.02)
        found = one.margins()
        assert found["crossover"] == pytest.approx(at_gain_1, rel=0.02)
        assert found["phase_margin"] == pytest.approx(180.0 - phase(at_gain_1), abs=2.0)
        assert found["gain_margin"] == pytest.approx(gain, abs=1.0)
        fine = np.geomspace(6.0, 480.0, 5000)
        assert found["modulus_margin"] == pytest.approx(np.abs(1.0 + opened(fine)).min(), rel=0.1)


@pytest.mark.parametrize("lag", [160.0, 200.0])
def test_a_phase_margin_counts_from_either_side(lag: float) -> None:
    """A loop that is 20 degrees from -180 where its gain is 1 has that phase margin, beyond -180, too."""
    frequency = np.geomspace(6.0, 480.0, 12)
    loop = Loop(frequency, 60.0 / frequency * np.exp(-1j * np.radians(lag)))
    assert loop.margins()["phase_margin"] == pytest.approx(20.0)
    assert math.isnan(loop.margins()["gain_margin"])


def test_joints_slide_in_one_direction_while_torques_are_swept(nominal: Nominal) -> None:
    """No joint turns back in the part that is evaluated, so that its friction slides; no sine is doubled."""
    case = make_case("sweep", nominal)
    assert case.sines is not None
    assert len(np.unique(case.sines.frequency)) == case.sines.frequency.size
    record = run_cs7b(case, nominal.setup)
    begin, end = case.sines.measured
    part = record.position[(record.times >= begin) & (record.times < end)][:: case.setup.rates.ratio * 5]
    steps = np.diff(part, axis=0)
    assert ((steps > 0.0).all(axis=0) | (steps < 0.0).all(axis=0)).all()


@pytest.mark.parametrize("period", [0.4, 1.5])
def test_size_and_period_of_hunting(period: float) -> None:
    """A triangular motion has its size and period; one slip, and rest within the encoder's counts, have none."""
    times = np.arange(0.0, 5.0, 1e-3)
    triangle = 2e-3 * np.abs((times / period) % 1.0 - 0.5)
    size, found = oscillation(triangle, 1e-3, 1e-6)
    assert (size, found) == (pytest.approx(1e-3, rel=0.01), pytest.approx(period, rel=0.01))
    slip = 1e-3 * (times > 2.0)
    assert oscillation(slip, 1e-3, 1e-6)[0] == 1e-3
    assert math.isnan(oscillation(slip, 1e-3, 1e-6)[1])
    counts = 1e-6 * (np.arange(5000) % 2)
    assert math.isnan(oscillation(counts, 1e-3, 3e-6)[1])


def test_overshoot_settling_and_what_is_left(nominal: Nominal) -> None:
    """A decaying oscillation at a step's end has overshoot, settling time and remaining error by its equation."""
    case = make_case("step", nominal)
    reference = set_points(case, nominal.setup)
    way = case.points.position[-1] - case.points.position[0]
    since = np.maximum(case.times - case.end, 0.0)
    ringing = np.where(case.times > case.end, 0.2 * np.exp(-since / 0.05) * np.sin(2 * np.pi * 25.0 * since), 0.0)
    exact = np.repeat(reference[:, 0], case.setup.rates.ratio, axis=0)[: case.ticks]
    values = measure(record_of(case, exact + np.outer(ringing + 1e-3 * (since > 0.0), way)), reference)
    fine = np.arange(0.0, 0.5, 1e-5)
    wave = 0.2 * np.exp(-fine / 0.05) * np.sin(2 * np.pi * 25.0 * fine) + 1e-3
    last = fine[np.flatnonzero(np.abs(wave) > 0.02)[-1]]
    for j, name in enumerate(case.setup.robot.joint_names):
        assert values["overshoot", name] == pytest.approx(wave.max(), rel=0.01)
        assert values["settling_time", name] == pytest.approx(last, abs=1e-3)
        assert values["rest_error", name] == pytest.approx(1e-3 * abs(way[j]), rel=0.01)


def test_every_quantity_has_its_limit_on_its_side(nominal: Nominal) -> None:
    """At its limit a value passes, beyond it fails: above for the most, below for the least; every limit is used."""
    case, limits = make_case("step", nominal), CheckLimits()
    used = set()
    for name, one in QUANTITIES.items():
        (finding,) = judge(case, {(name, "joint_1"): 1.0}, {(name, "joint_1"): 2.0}, limits)
        if not one.limit:
            assert math.isnan(finding.limit)
            continue
        used |= {one.limit, f"{one.limit}_factor", f"{one.limit}_allowance"}
        if one.factor:
            factor, allowance = (getattr(limits, f"{one.limit}_{end}") for end in ("factor", "allowance"))
            assert finding.limit == 2.0 * factor + allowance
        for value, passed in ((finding.limit, True), (finding.limit + (-1e-9 if one.least else 1e-9), False)):
            (again,) = judge(case, {(name, "joint_1"): value}, {(name, "joint_1"): 2.0}, limits)
            assert again.passed is passed, again.text
    assert {field.name for field in fields(CheckLimits)} <= used


def test_the_cs7b_passes_and_bad_gains_fail(nominal: Nominal) -> None:
    """The shipped gains keep all limits in all cases; gains four times as stiff lose their margins, weak ones hunt."""
    weak = {"controller.kp[*]": 20.0, "controller.kv[*]": 60.0, "controller.ki[*]": 3e4}
    stiff = {"controller.kv[*]": 1600.0}
    failed: dict[str, set[str]] = {"weak": set(), "stiff": set()}
    for name in CASES:
        case = make_case(name, nominal)
        reference = set_points(case, nominal.setup)
        good = measure(run_cs7b(case, nominal.setup), reference)
        found = judge(case, good, good, CheckLimits())
        assert [one.text for one in found if not one.passed] == []
        for law, values in (("weak", weak), ("stiff", stiff)):
            if name in ("sweep", "rest"):
                bad = measure(run_cs7b(case, with_parameters(nominal.setup, values)), reference)
                failed[law] |= {one.quantity for one in judge(case, bad, good, CheckLimits()) if not one.passed}
    assert failed["stiff"] >= {"gain_margin", "phase_margin", "modulus_margin", "torque_ripple"}
    assert failed["weak"] >= {"hunting", "rest_error", "tracking_error_rms"}


def test_other_arms_are_the_nominal_one_but_for_what_is_named(nominal: Nominal) -> None:
    """Payload and friction are those of the files times their factors; drives give less than the CS7B needs."""
    for factor in (0.7, 1.3):
        payload, friction = (make_case(f"{what}_{factor:g}", nominal).setup for what in ("payload", "friction"))
        heavier = payload.robot.chain.mass[5] - nominal.setup.robot.chain.mass[5]
        assert heavier == pytest.approx((factor - 1.0) * 3.5)
        assert payload.friction.elements == nominal.setup.friction.elements
        for one, usual in zip(friction.friction.elements, nominal.setup.friction.elements, strict=True):
            assert (one.tau_c_positive, one.c2) == pytest.approx((factor * usual.tau_c_positive, factor * usual.c2))
            assert (one.c0, one.omega_s) == (usual.c0, usual.omega_s)
    case = make_case("saturation", nominal)
    needed = np.abs(run_cs7b(make_case("step", nominal), nominal.setup).sent).max(axis=0)
    assert case.setup.drives.peak_torque == pytest.approx(0.8 * needed)
    lost = make_case("dropped", nominal)
    assert lost.lost is not None
    assert 0.01 < lost.lost.mean() < 0.03
    assert not lost.lost[: lost.setup.rates.ticks_of(START)].any()
