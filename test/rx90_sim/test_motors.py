"""The motors: cogging that gives and takes no energy, windings that get warm, and what the amplifier does about it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from elastic_arms import POSE, SOFT, WRIST, elastic, energy, floating, free
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import COPPER, Cogging, Windings
from rx90_common.kernels.compiled import kernel
from rx90_emulator.loop.setup import Setup
from rx90_sim.drives import add_cogging, current_shares, fill_windings, warm_motors, warm_windings, winding_dtype
from rx90_sim.plant import Plant

Array = NDArray[np.float64]
TERMS = Cogging(
    np.array([2.0, 6.0, 36.0]),
    np.array([[0.05] * 6, [0.1] * 6, [0.02] * 6]),
    np.random.default_rng(1).uniform(-3.0, 3.0, (3, 6)),
)


def cogged(setup: Setup, cogging: Cogging = TERMS) -> Setup:
    """Return a setup with cogging."""
    return dataclasses.replace(setup, drives=dataclasses.replace(setup.drives, cogging=cogging))


def wells(setup: Setup, motors: Array) -> float:
    """Return the energy of the cogging at motor angles, rad, J: minus the integral of the torque."""
    cogging = setup.drives.cogging
    harmonic = cogging.harmonic[:, None]
    return float(-np.sum(cogging.amplitude / harmonic * np.sin(harmonic * motors + cogging.phase)))


@kernel
def cog(plants: Any, states: Any, angle: Array, velocity: Array, torque: Array, step: float) -> None:
    """Add the mean cogging over a step to joint torques."""
    add_cogging(plants[0], states[0], angle, velocity, torque, step)


def test_the_mean_over_a_step_is_exact_at_every_speed(shipped: Setup) -> None:
    """Slow and fast, the mean of a wave is its middle times sin(x) / x with half the way in its angle as x."""
    plant, rng, step = cogged(shipped).plant(), np.random.default_rng(9), shipped.rates.period
    for speed in 10.0 ** np.arange(-6.0, 2.0, 0.25):
        angle, velocity, torque = rng.uniform(-1.0, 1.0, 6), speed * rng.uniform(0.3, 1.0, 6), np.zeros(6)
        cog(plant.constants, plant.state, angle, velocity, torque, step)
        middle, half = (shipped.drives.gear * (WRIST @ one) for one in (angle, 0.5 * step * velocity))
        harmonic = TERMS.harmonic[:, None]
        means = TERMS.amplitude * np.cos(harmonic * middle + TERMS.phase) * np.sinc(harmonic * half / np.pi)
        assert torque == pytest.approx(WRIST.T @ (shipped.drives.gear * means.sum(axis=0)), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("gears", ["rigid", "elastic"])
def test_cogging_creates_no_energy(shipped: Setup, gears: str) -> None:
    """Over 10^4 random cycles the motors' work is what arm and cogging gain, to 3e-6 of what was moved to and fro."""
    setup = cogged(floating(shipped))
    if gears == "elastic":
        setup = elastic(setup, SOFT)
    plant, rng, peak = setup.plant(), np.random.default_rng(12), setup.drives.peak_torque
    state, gear, twist = free(plant, POSE), setup.drives.gear, plant.state["transmission"]["twist"][0]
    rate = plant.state["transmission"]["rate"][0]
    last = WRIST @ state["q"] + twist
    start, work, moved = energy(setup, state) + wells(setup, gear * last), 0.0, 0.0
    for _ in range(10_000):
        wanted = rng.uniform(-1.0, 1.0, 6)
        for _ in range(4):
            plant.step((wanted - 0.3 * (WRIST @ state["v"] + rate)) * peak)
            turned = WRIST @ state["q"] + twist
            done = plant.motor_states()[2] * gear * (turned - last)
            work, moved, last = work + done.sum(), moved + np.abs(done).sum(), turned
    created = energy(setup, state) + wells(setup, gear * last) - start - work
    assert moved > 500.0  # J
    assert abs(created) < 3e-6 * moved


def test_brakes_hold_against_cogging(shipped: Setup) -> None:
    """After a reset nothing moves: the brakes hold weight and cogging, behind rigid and elastic gears."""
    for setup in (cogged(shipped), cogged(elastic(shipped, SOFT))):
        plant = setup.plant()
        plant.reset(POSE)
        links = plant.joint_states()[0].copy()
        for _ in range(100):
            plant.step(None)
        assert np.abs(plant.joint_states()[0] - links).max() < 1e-11


def windings(**changes: object) -> Windings:
    """Return windings of a small servo motor."""
    six = np.ones(6)
    values = {
        "resistance": 2.0 * six, "thermal_resistance": 1.5 * six, "heat_capacity": 40.0 * six, "ambient": 25.0,
        "initial": 25.0, "derating": 120.0, "limit": 140.0,
    }  # fmt: skip
    return Windings(**{**values, **changes})  # type: ignore[arg-type]


def warmed(setup: Setup, parts: Windings, torque: Array, step: float, count: int) -> Array:
    """Return the temperatures after so many steps of constant torque, degrees, shape (6,)."""
    record = np.zeros(1, winding_dtype(6))
    fill_windings(record[0], parts, setup.drives.torque_constant)
    temperature = np.full(6, parts.initial)
    for _ in range(count):
        warm_windings(record[0], torque, temperature, step)
    return temperature


def test_resistance_that_rises_against_a_solver(shipped: Setup) -> None:
    """Of copper or with constant resistance, 50 seeded windings follow SciPy's answer, also where they run away."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        resistance, capacity = rng.uniform(0.5, 5.0, 6), rng.uniform(20.0, 200.0, 6)
        outwards, current = rng.uniform(0.5, 3.0, 6), rng.uniform(0.0, 8.0, 6)
        slope = float(rng.choice([0.0, COPPER]))
        parts = windings(
            resistance=resistance, heat_capacity=capacity, thermal_resistance=outwards, derating=1e6, limit=2e6,
            coefficient=slope,
        )  # fmt: skip

        def rates(_: float, t: Array, r: Array = resistance, c: Array = capacity, o: Array = outwards,
                  i: Array = current, a: float = slope) -> Array:  # fmt: skip
            return np.asarray((r * i**2 * (1.0 + a * (t - 20.0)) - (t - 25.0) / o) / c)

        want = solve_ivp(rates, (0.0, 60.0), np.full(6, 25.0), "LSODA", rtol=1e-11, atol=1e-10).y[:, -1]
        found = warmed(shipped, parts, current * shipped.drives.torque_constant, 0.1, 600)
        assert found == pytest.approx(want, rel=1e-8)


def test_the_amplifier_folds_back(shipped: Setup) -> None:
    """Above the first temperature the peak torque falls linearly, at the limit it is 0; a reset cools the windings."""
    drives = dataclasses.replace(
        shipped.drives, winding=windings(heat_capacity=np.full(6, 0.02), thermal_resistance=np.full(6, 9.0))
    )
    plant = dataclasses.replace(shipped, drives=drives).plant()
    peak = drives.peak_torque
    hot = np.array([100.0, 120.0, 125.05, 130.0, 138.0, 150.0])
    plant.state["temperature"][0] = hot
    words = warm_motors(plant.constants, hot).split(", ")
    assert words[0] == "motor_3 at 125.0 °C has 74 % of its peak current"  # 74.75: no more than there is
    assert len(words) == 4
    plant.step(2.0 * peak)
    share = np.clip((140.0 - hot) / 20.0, 0.0, 1.0)
    assert plant.motor_states()[2] == pytest.approx(peak * share, abs=1e-12)
    assert plant.saturated.tolist() == [1] * 6
    assert current_shares(plant.constants, plant.winding_temperatures()) == pytest.approx(
        np.clip((140.0 - plant.winding_temperatures()) / 20.0, 0.0, 1.0), abs=1e-12
    )
    plant.reset(np.zeros(6))
    assert plant.winding_temperatures() == pytest.approx(25.0)
    for _ in range(2000):
        plant.step(np.sign(np.arange(6) % 2 - 0.5) * peak * (np.arange(6) > 3))
    assert np.all(plant.winding_temperatures() < 140.0)
    assert plant.winding_temperatures()[4] > 120.0


def test_cold_windings_stay_cold(shipped: Setup) -> None:
    """Without the block nothing gets warm and no torque is limited."""
    plant: Plant = shipped.plant()
    for _ in range(10):
        plant.step(10.0 * shipped.drives.peak_torque)
    assert np.all(plant.winding_temperatures() == 20.0)
    assert current_shares(plant.constants, plant.winding_temperatures()).tolist() == [1.0] * 6
    assert warm_motors(plant.constants, plant.winding_temperatures()) == ""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"derating": 140.0}, "winding: derating is 140 °C; accepted: below limit = 140 °C"),
        ({"initial": 130.0}, "winding: derating is 120 °C; accepted: at least 130 °C"),
    ],
)
def test_windings_that_cannot_be_are_refused(changes: dict[str, object], said: str) -> None:
    """One line names value and what is accepted."""
    with pytest.raises(ConfigError, match=said):
        windings(**changes)
