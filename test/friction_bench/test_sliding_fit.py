"""The fit of all ramps from where the shaft slides, and the plan that the first ramp gives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_triangular

from benchmarks.friction_ramp import QuickRig, random_rig, truth_of
from friction_bench.experiment.identification import identify_ramps
from friction_bench.experiment.job import plan_from, run_ramp
from friction_bench.experiment.record import RampModel, RampRecord
from friction_bench.experiment.sliding_fit import whiten
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.share import config_path
from rx90_common.friction.element import FrictionElement


def quiet(rig: Rig) -> Rig:
    """Return the rig without noise and gain error."""
    assert rig.plant is not None
    return replace(rig, plant=replace(rig.plant, gain_error=0.0, torque_noise=0.0, adc_noise=0.0))


def own(rig: Rig, coulomb: float, viscous: float, inertia: float) -> Rig:
    """Return the rig with this friction and inertia at the motor, without a load."""
    assert rig.plant is not None
    load = (inertia - rig.plant.rotor_inertia) * rig.gear_ratio**2 * rig.gear_efficiency
    return replace(rig, plant=replace(rig.plant, coulomb=coulomb, viscous=viscous, load_inertia=load))


def integrated_ou_covariance(time: Array, T: float) -> Array:
    """Return the covariance of an integrated Ornstein-Uhlenbeck process from rest at time 0, shape (n, n).

    With unit intensity: K(s, t) = int_0^min(s, t) (1 - e^-(s-u)/T) (1 - e^-(t-u)/T) du.
    """
    s = np.minimum.outer(time, time)
    gap = np.abs(np.subtract.outer(time, time))
    far = np.exp(-gap / T)
    return s + T * np.expm1(-s / T) - T * (far - np.exp(-(s + gap) / T)) + T / 2 * (far - np.exp(-(2 * s + gap) / T))


def test_integrated_ou_covariance_is_that_of_simulated_noise() -> None:
    """The covariance formula equals the sample covariance of an inertia driven by white noise."""
    rng = np.random.default_rng(3)
    T, h, n = 0.3, 0.01, 100
    speed = np.zeros(4000)
    angle = np.zeros(4000)
    kept = []
    decay = math.exp(-h / T)
    for _ in range(n):
        kick = rng.standard_normal(4000) / math.sqrt(h)
        angle += kick * h + (speed - kick) * T * (1 - decay)
        speed = kick + (speed - kick) * decay
        kept.append(angle.copy())
    time = h * np.arange(1, n + 1)
    chosen = [19, 49, 99]
    sample = np.cov(np.array(kept)[chosen])
    assert integrated_ou_covariance(time[chosen], T) == pytest.approx(sample, rel=0.12)


def test_whitening_is_the_inverse_cholesky_factor() -> None:
    """The Kalman filter's innovations are L^-1 y and its determinant that of V = L L' = r I + q K, at uneven times."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.05, 60))
    T, q, r = 0.08, 3e-3, 1.3e-5
    L = np.linalg.cholesky(r * np.eye(time.size) + q * integrated_ou_covariance(time - time[0], T))
    columns = rng.standard_normal((3, time.size))
    white, determinant = whiten(time, columns, T, q, r)
    assert white == pytest.approx(solve_triangular(L, columns.T, lower=True).T, rel=1e-6, abs=1e-6)
    assert determinant == pytest.approx(2 * np.log(np.diag(L)).sum(), rel=1e-9)


def test_release_is_the_solution_of_equation_3() -> None:
    """With static friction above f_c the closed form is what a solver makes of a shaft that starts at break-away."""
    model = RampModel(coulomb=0.05, viscous=8e-4, inertia=6e-5, slope=0.03, release=0.01)
    time = model.break_away_time + np.linspace(0.0, 1.0, 20)

    def derivative(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (0.03 * t - 0.05 - 8e-4 * y[1]) / 6e-5]

    exact = solve_ivp(derivative, (time[0], time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-10, atol=1e-12).y
    assert model.break_away_time == pytest.approx(2.0)
    assert model.angle(time) == pytest.approx(exact[0], rel=1e-6, abs=1e-8)
    assert model.velocity(time) == pytest.approx(exact[1], rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("kind", ["Coulomb-viscous", "LuGre"])
def test_quick_ramps_are_those_of_the_rig_with_its_firmware(kind: str) -> None:
    """Without noise the compiled ramp gives the readings of the real firmware on the emulated rig, to one count."""
    rig = quiet(random_rig(1, 2, kind))
    emulated = EmulatedRig(rig, 0)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    emulated.plant.load(True)
    record = run_ramp(client, 0.05, 0.15, True, "real")
    quick = QuickRig(rig, 0).ramp(0.05, 0.15, True, "quick")
    assert quick.torque == pytest.approx(record.torque)
    assert np.abs(quick.angle - record.angle).max() <= 1.01 * record.angle_step


@pytest.mark.parametrize("kind", ["Coulomb-viscous", "LuGre"])
def test_intervals_hold_whatever_the_release(kind: str) -> None:
    """On random rigs the true f_c, f_v and J lie in most 95 % intervals and within 4.5 standard uncertainties."""
    deviations = []
    for number in range(6):
        rig = random_rig(1, number, kind)
        quick = QuickRig(rig, number)
        records = [quick.ramp(slope, 0.16, True, f"{slope} {k}") for k in range(3) for slope in (0.02, 0.05)]
        best = identify_ramps(records, rig.scale_uncertainty).best
        assert best.inertia is not None
        for estimate, truth in zip((best.coulomb, best.viscous, best.inertia), truth_of(rig, True), strict=True):
            deviations.append((estimate.value - truth) / estimate.error)
            assert estimate.error < 0.15 * truth
    assert np.abs(deviations).max() < 4.5
    assert np.mean(np.abs(deviations) < 1.96) >= 14 / 18


def test_wide_stribeck_effect_does_not_bias_coulomb_friction() -> None:
    """A release that lasts until the shaft turns at tens of rad/s, without noise: f_c and f_v within 0.5 %."""
    rig = quiet(load_rig(config_path("rig/gm8224_lugre.yaml")))
    assert rig.plant is not None
    assert isinstance(rig.plant.joint, FrictionElement)
    wide = replace(rig.plant.joint, tau_s_positive=1.35, tau_s_negative=1.35, omega_s=0.2)
    rig = replace(rig, plant=replace(rig.plant, joint=wide))
    quick = QuickRig(rig, 3)
    records = [quick.ramp(slope, 0.16, True, f"{slope}") for slope in (0.02, 0.05)]
    found = identify_ramps(records, 0.0)
    coulomb, viscous, _ = truth_of(rig, True)
    assert found.best.coulomb.value == pytest.approx(coulomb, rel=5e-3)
    assert found.best.viscous.value == pytest.approx(viscous, rel=5e-3)
    assert found.stribeck is not None
    assert found.stribeck > 0.99


def test_ramps_that_cannot_be_used_are_named_and_the_others_count(rig: Rig) -> None:
    """One ramp whose current saturates is left out with its label and reason; the rest carries the estimate."""
    quick = QuickRig(own(rig, 0.05, 8e-4, 6e-5), 1)
    records = [quick.ramp(slope, 0.15, False, f"ramp {slope} {k}") for k in range(2) for slope in (0.02, 0.05)]
    assert records[1].measured_torque is not None
    records[1] = replace(records[1], measured_torque=np.minimum(records[1].measured_torque, 0.1))
    found = identify_ramps(records, rig.scale_uncertainty)
    assert [ramp.record.label for ramp in found.ramps] == ["ramp 0.02 0", "ramp 0.02 1", "ramp 0.05 1"]
    assert len(found.unused) == 1
    assert found.unused[0].startswith("ramp 0.05 0: the measured torque falls")
    assert found.best.coulomb.value == pytest.approx(0.05, rel=0.01)


def first_ramp(rig: Rig) -> RampRecord:
    """Return the first ramp of a measurement."""
    return QuickRig(rig, 1).ramp(min(rig.ramps.slopes), rig.ramps.end_torque, False, "first")


@pytest.mark.parametrize(
    ("friction", "kept"),
    [((0.03, 6.4e-4, 1.3e-5), True), ((0.10, 6e-4, 1.5e-4), False), ((0.11, 1e-3, 2e-5), False)],
)
def test_plan_gives_each_ramp_time_enough_to_slide(friction: tuple[float, float, float], kept: bool, rig: Rig) -> None:
    """Slopes that suit the rig are kept; else planned ramps slide for 8 time constants and 1.4 s, within the travel."""
    coulomb, viscous, inertia = friction
    changed = own(rig, *friction)
    plan = plan_from(first_ramp(changed), changed.ramps, changed)
    assert (plan.slopes == rig.ramps.slopes) is kept
    rise = plan.end_torque - coulomb
    travel = rise**2 / (2 * viscous * min(plan.slopes))
    assert rise / max(plan.slopes) >= max(1.4, 8 * inertia / viscous)
    assert travel < math.tau * rig.load_travel * rig.gear_ratio
    assert max(plan.slopes) >= 1.8 * min(plan.slopes)
    assert plan.repeats * rise / max(plan.slopes) / rig.tick >= 280
    assert plan.end_torque == rig.ramps.end_torque


def test_ramp_ends_before_the_firmware_trips(rig: Rig) -> None:
    """Where the end torque would mean twice the speed limit, a ramp ends short of that limit, without a fault."""
    light = own(rig, 0.01, 3e-4, 2e-5)
    client = RigClient(VirtualPort(EmulatedRig(light, 2)), light)
    client.connect()
    record = run_ramp(client, 0.05, 0.15, False, "light")
    speed = (record.angle[-1] - record.angle[-6]) / (record.time[-1] - record.time[-6])
    assert 0.85 * rig.speed_limit < speed < rig.speed_limit
    assert client.last is not None
    assert client.last.report.fault == 0
