"""Friction elements with parts in the plant, against solvers, and the temperature of its joints."""

import dataclasses

import numpy as np
import pytest
from elastic_arms import SOFT, elastic
from full_friction import TEMPERATURE

from benchmarks.friction_parts import POSE, STEPS, THROUGH, convergence, loaded, snapshot, with_elements
from rx90_common.base.arrays import Array
from rx90_common.description.drives import Windings
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant, beyond_law


@pytest.fixture(scope="module")
def arm(shipped: Setup) -> Setup:
    return loaded(shipped)


def test_second_order_with_load_and_ripple(arm: Setup) -> None:
    """Under torques that jump, joints, bristles and transmitted torques converge with order 2 to the continuous law."""
    errors = convergence(arm)
    order = -np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    assert order == pytest.approx(np.full(4, 2.0), abs=0.3)
    assert np.all(errors[0] < [1e-5, 1e-3, 3e-6, 0.1])  # rad, rad/s, rad, Nm at one step in a tick


def test_the_load_is_what_the_links_ask_for(arm: Setup) -> None:
    """Held by its brakes and moved by its motors, a joint transmits what Pinocchio's arm without rotors needs."""
    plant, model = arm.plant(), arm.robot.model
    nothing, spring = np.zeros((1, 6)), arm.drives.spring_torque

    def needed(q: Array, v: Array, a: Array) -> Array:
        return THROUGH @ rigid_torque(model, np.zeros((6, 6)), spring, q[None], v[None], a[None])[0]

    soft = elastic(arm, SOFT).plant()
    soft.reset(POSE)
    for _ in range(100):
        soft.step(None)
    hangs = needed(soft.state["q"][0], nothing[0], nothing[0])
    assert soft.state["parts"]["load"]["torque"][0] == pytest.approx(hangs, rel=1e-9, abs=1e-9)
    gears, before = soft.state["transmission"][0], soft.state["parts"]["load"]["torque"][0].copy()
    gears["twist"][5] += 1e-3  # gear 6 lets its torque go through elements 6 and 7, not through 5
    soft.step(None)
    through = gears["torque"][[0, 1, 2, 3, 4, 5, 5]]
    assert abs(through[5]) > 1.0
    relax = np.array([e.load.relax_time for e in arm.friction.elements if e.load])
    want = through + (before - through) * np.exp(-arm.rates.period / relax)
    assert soft.state["parts"]["load"]["torque"][0] == pytest.approx(want, rel=1e-9)

    plant.reset(POSE)
    weight = needed(POSE, nothing[0], nothing[0])
    assert plant.state["parts"]["load"]["torque"][0] == pytest.approx(weight, rel=1e-9, abs=1e-9)
    for _ in range(400):
        plant.step(None)
    assert plant.state["parts"]["load"]["torque"][0] == pytest.approx(weight, rel=1e-5, abs=1e-5)
    motor = 0.2 * arm.drives.peak_torque
    for _ in range(300):
        plant.step(motor)
    state = plant.state[0]
    assert np.abs(state["v"][:5]).min() > 0.1
    moving = needed(state["q"], state["v"], state["acceleration"])
    assert np.abs(moving - weight).max() > 5.0
    assert state["parts"]["load"]["torque"] == pytest.approx(moving, abs=0.02 * np.abs(moving).max())


def test_the_walk_of_the_scatter_goes_on_by_ticks(shipped: Setup) -> None:
    """However many steps the plant takes in a tick, the factors are the same ones, other ones in each tick."""
    setup, seen = with_elements(shipped, scatter=ScatterPart(deviation=0.05, correlation_time=0.02)), []
    for substeps in (1, 3):
        plant = setup.plant(substeps)
        rows = []
        for _ in range(20):
            plant.step(None)
            rows.append(plant.state["parts"]["scatter"]["factor"][0].copy())
        seen.append(np.array(rows))
    assert np.array_equal(*seen)
    assert np.abs(np.diff(seen[0], axis=0)).min() > 0.0


def test_a_reset_begins_again_to_the_last_bit(arm: Setup) -> None:
    """With all parts the ticks after a reset are those after the first one; another seed's are not."""
    warm = TEMPERATURE.replaced(capacity=0.05)
    setup = with_elements(arm, scatter=ScatterPart(deviation=0.05, correlation_time=0.02), temperature=warm)

    def ticks(plant: Plant) -> Array:
        plant.reset(POSE)
        rows = []
        for _ in range(100):
            plant.step(0.3 * setup.drives.peak_torque)
            warmth = plant.temperatures, plant.state["parts"]["temperature"]["heat"][0]
            rows.append(np.concatenate([snapshot(plant), plant.friction_states()[2], *warmth]))
        assert np.ptp(plant.temperatures) > 0.01
        return np.array(rows)

    plant = setup.plant()
    first = ticks(plant)
    assert np.array_equal(ticks(plant), first)
    assert np.array_equal(ticks(setup.plant()), first)
    assert not np.array_equal(ticks(dataclasses.replace(setup, seed=1).plant()), first)


PART = TEMPERATURE.replaced(highest=80.0, resistance=2.0, motor_share=0.4)
TORQUE = np.array([0.1, -0.2, 0.15, 0.05, 0.04, 0.06])
"""At which the brakes, and friction, hold the joints, motor side, Nm."""


def warm(setup: Setup, part: TemperaturePart = PART, **windings: float) -> Setup:
    elements = tuple(
        element if i == 1 else element.replaced(temperature=part) for i, element in enumerate(setup.friction.elements)
    )
    cold = {"heat_capacity": np.full(6, 1e9), "thermal_resistance": np.full(6, 1.0)}
    values = {"ambient": 20.0, "initial": 20.0, "derating": 150.0, "limit": 170.0, **cold, **windings}
    drives = setup.drives.replaced(winding=Windings(resistance=np.arange(2.0, 8.0), **values))  # type: ignore[arg-type]
    return dataclasses.replace(setup, drives=drives, friction=dataclasses.replace(setup.friction, elements=elements))


def at_rest(setup: Setup, ticks: int) -> Array:
    plant = setup.plant()
    plant.constants["brake"]["tau_c"] = plant.constants["brake"]["tau_s"] = 1e9
    for _ in range(ticks):
        plant.step(TORQUE)
        plant.state["v"] = plant.state["acceleration"] = 0.0  # held by whoever holds it
    return plant.temperatures.copy()


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
    bare = at_rest(warm(shipped, PART.replaced(motor_share=0.0)), 500)
    rise = (hot - bare) / (cold - bare).clip(1e-9)
    assert rise[[0, 2, 3, 4, 6]] == pytest.approx(1.0 + 0.00393 * 80.0, rel=1e-6)


def test_a_moving_arm_warms_by_its_friction(shipped: Setup) -> None:
    """What all joints get as heat is what friction took, by torques and velocities of the ticks; a reset cools them."""
    setup = warm(shipped, PART.replaced(motor_share=0.0))
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
    assert beyond_law(plant.friction, plant.temperatures) == ""
    plant.state["parts"]["temperature"]["temperature"][0, 2:4] = 80.06, 80.0
    said = "joint_3 at 80.1 °C keeps the friction of 80 °C, the highest of its law"
    assert beyond_law(plant.friction, plant.temperatures) == said
    plant.reset(np.zeros(6))
    assert plant.temperatures.tolist() == [30.0, 0.0, 30.0, 30.0, 30.0, 30.0, 30.0]


def test_above_its_law_friction_stays(shipped: Setup) -> None:
    """A joint that is warmer than `highest` has the friction that it has there, to the last bit."""
    setup, torques = warm(shipped), []
    for temperature in (80.0, 95.0):
        plant = setup.plant()
        plant.reset([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])
        plant.constants["parts"]["temperature"]["gain"] = 0.0
        plant.state["parts"]["temperature"]["temperature"][0, [0, 2, 3, 4, 5, 6]] = temperature
        for _ in range(100):
            plant.step(0.2 * setup.drives.peak_torque)
        torques.append(plant.friction_states()[2].copy())
    assert np.array_equal(*torques)
