"""Joints that get warm in the plant: heat of motors and friction, what a reset does, who is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.description.drives import Windings
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
PART = TemperaturePart(40.0, 20.0, 80.0, 30.0, 25.0, 0.5, 2.0, 20.0, 0.3, 0.02, 0.01, motor_share=0.4)
TORQUE = np.array([0.1, -0.2, 0.15, 0.05, 0.04, 0.06])
"""At which the brakes, and friction, hold the joints, motor side, Nm."""


def warm(setup: Setup, part: TemperaturePart = PART, **windings: float) -> Setup:
    """Return a setup with the part in all elements but the second, and with windings of 2 to 7 Ohm."""
    elements = tuple(
        element if i == 1 else dataclasses.replace(element, temperature=part)
        for i, element in enumerate(setup.friction.elements)
    )
    cold = {"heat_capacity": np.full(6, 1e9), "thermal_resistance": np.full(6, 1.0)}
    values = {"ambient": 20.0, "initial": 20.0, "derating": 150.0, "limit": 170.0, **cold, **windings}
    drives = dataclasses.replace(setup.drives, winding=Windings(np.arange(2.0, 8.0), **values))  # type: ignore[arg-type]
    return dataclasses.replace(setup, drives=drives, friction=dataclasses.replace(setup.friction, elements=elements))


def at_rest(setup: Setup, ticks: int) -> Array:
    """Return the temperatures after a time in which motors push an arm that does not move."""
    plant = setup.plant()
    plant.constants["brake"]["tau_c"] = plant.constants["brake"]["tau_s"] = 1e9
    for _ in range(ticks):
        plant.step(TORQUE)
        plant.state["v"] = plant.state["acceleration"] = 0.0  # held by whoever holds it
    return plant.temperatures.now.copy()


def test_motors_warm_the_joints_that_they_drive(shipped: Setup) -> None:
    """At rest the heat is share I^2 R of the own motor; motor 6 warms the seventh element, and none the sixth."""
    setup, ticks = warm(shipped), 2000
    got = at_rest(setup, ticks)
    power = 0.4 * np.arange(2.0, 8.0) * (TORQUE / setup.drives.torque_constant) ** 2
    heat = np.array([*power[:5], 0.0, power[5]])
    end, fading = PART.ambient + 2.0 * heat, np.exp(-ticks * setup.rates.period / (2.0 * 0.5))
    want = end + (PART.start - end) * fading
    want[1] = 0.0  # has no temperature
    assert got == pytest.approx(want, abs=2e-3)  # what little the bristles take
    assert abs(want[4] - want[5]) > 5e-3


def test_a_warm_winding_heats_more(shipped: Setup) -> None:
    """The resistance is that of the winding's temperature: at 80 degrees above its reference a third more of heat."""
    cold, hot = (at_rest(warm(shipped, initial=t), 500) for t in (20.0, 100.0))
    rise = (hot - at_rest(warm(shipped, dataclasses.replace(PART, motor_share=0.0)), 500)) / (
        cold - at_rest(warm(shipped, dataclasses.replace(PART, motor_share=0.0)), 500)
    ).clip(1e-9)
    assert rise[[0, 2, 3, 4, 6]] == pytest.approx(1.0 + 0.00393 * 80.0, rel=1e-6)


def test_a_moving_arm_warms_by_its_friction(shipped: Setup) -> None:
    """What all joints get as heat is what friction took, by torques and velocities of the ticks; a reset cools them."""
    setup = warm(shipped, dataclasses.replace(PART, motor_share=0.0))
    plant = setup.plant()
    plant.reset([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
    taken, before = np.zeros(7), 0.0
    for k in range(2000):
        plant.step(0.3 * setup.drives.peak_torque * np.sin(k / 100.0))
        _, velocity, torque = plant.friction_states()
        power = velocity * torque
        taken, before = taken + 0.5 * setup.rates.period * (power + before), power.copy()
    stored = 0.5 * np.array([e.c0 for e in setup.friction.elements]) * plant.state["z"][0] ** 2
    heat = plant.state["parts"]["temperature"]["heat"][0]
    assert heat == pytest.approx(taken - stored, rel=2e-3, abs=2e-3)
    assert heat[[0, 2]].min() > 3.0
    assert plant.temperatures.beyond_law() == ""
    plant.state["parts"]["temperature"]["temperature"][0, 2:4] = 80.06, 80.0
    assert plant.temperatures.beyond_law() == "joint_3 at 80.1 °C keeps the friction of 80 °C, the highest of its law"
    plant.reset(np.zeros(6))
    assert plant.temperatures.now.tolist() == [30.0, 0.0, 30.0, 30.0, 30.0, 30.0, 30.0]
    assert plant.temperatures.elements == (0, 2, 3, 4, 5, 6)


def test_a_temperature_that_is_set_counts_at_once(shipped: Setup) -> None:
    """Before any tick the viscous friction is c2 (f + (1 - f) exp(-(T - reference) / T_V)), T of each joint its own."""
    setup, torques = warm(shipped), []
    temperatures = np.array([60.0, 55.0, 50.0, 45.0, 40.0, 35.0, 30.0])
    for wanted in (temperatures, np.full(7, PART.reference)):
        plant = setup.plant()
        plant.reset(np.zeros(6))
        plant.state["v"] = 0.5
        plant.temperatures.set(wanted)
        assert plant.temperatures.now.tolist() == [wanted[0], 0.0, *wanted[2:]]  # the second has none
        torques.append(plant.friction_states()[2].copy())
    velocity = np.array([*[0.5] * 6, 1.0])
    c2 = np.array([e.c2 * (e.temperature is not None) for e in setup.friction.elements])
    want = c2 * velocity * 0.7 * np.expm1(-(temperatures - PART.reference) / PART.viscous_scale)
    assert torques[0] - torques[1] == pytest.approx(want, abs=1e-12)


def test_above_its_law_friction_stays(shipped: Setup) -> None:
    """A joint that is warmer than `highest` has the friction that it has there, to the last bit."""
    setup, torques = warm(shipped), []
    for temperature in (80.0, 95.0):
        plant = setup.plant()
        plant.reset([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
        plant.constants["parts"]["temperature"]["gain"] = 0.0
        plant.temperatures.set(temperature)
        for _ in range(100):
            plant.step(0.2 * setup.drives.peak_torque)
        torques.append(plant.friction_states()[2].copy())
    assert np.array_equal(*torques)
