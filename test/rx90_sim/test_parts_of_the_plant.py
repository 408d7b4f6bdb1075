"""Friction elements with parts in the plant, against a stiff solver of the same law in continuous time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from elastic_arms import SOFT, elastic
from numpy.typing import NDArray

from benchmarks.friction_parts import POSE, STEPS, THROUGH, convergence, loaded, snapshot, with_elements
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_emulator.identification.arm import rigid_torque
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def arm(shipped: Setup) -> Setup:
    """Return the shipped arm with a load part in every element, and a ripple in three."""
    return loaded(shipped)


def test_second_order_with_load_and_ripple(arm: Setup) -> None:
    """Under torques that jump, joints, bristles and transmitted torques converge with order 2 to the continuous law."""
    errors = convergence(arm)
    order = -np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    assert order == pytest.approx(np.full(4, 2.0), abs=0.3)
    assert np.all(errors[0] < [1e-5, 1e-3, 3e-6, 0.1])  # rad, rad/s, rad, Nm at one step in a tick


def test_the_load_is_what_the_links_ask_for(arm: Setup) -> None:
    """Held by its brakes and moved by its motors, a joint transmits what Pinocchio's arm without rotors needs.

    So does one that hangs in an elastic gear, held.
    """
    plant, model = arm.plant(), arm.robot.model
    nothing, spring = np.zeros((1, 6)), arm.drives.spring_torque

    def needed(q: Array, v: Array, a: Array) -> Array:
        return THROUGH @ rigid_torque(model, np.zeros((6, 6)), spring, q[None], v[None], a[None])[0]

    soft = elastic(arm, SOFT).plant()
    soft.reset(POSE)
    for _ in range(100):
        soft.step(None)
    hangs = needed(soft.state["q"][0], nothing[0], nothing[0])
    assert soft.state["parts"]["load"][0] == pytest.approx(hangs, rel=1e-9, abs=1e-9)
    gears, before = soft.state["transmission"][0], soft.state["parts"]["load"][0].copy()
    gears["twist"][5] += 1e-3  # gear 6 lets its torque go through elements 6 and 7, not through 5
    soft.step(None)
    through = gears["torque"][[0, 1, 2, 3, 4, 5, 5]]
    assert abs(through[5]) > 1.0
    relax = np.array([e.load.relax_time for e in arm.friction.elements if e.load])
    want = through + (before - through) * np.exp(-arm.rates.period / relax)
    assert soft.state["parts"]["load"][0] == pytest.approx(want, rel=1e-9)

    plant.reset(POSE)
    weight = needed(POSE, nothing[0], nothing[0])
    assert plant.state["parts"]["load"][0] == pytest.approx(weight, rel=1e-9, abs=1e-9)
    for _ in range(400):
        plant.step(None)
    assert plant.state["parts"]["load"][0] == pytest.approx(weight, rel=1e-5, abs=1e-5)
    motor = 0.2 * arm.drives.peak_torque
    for _ in range(300):
        plant.step(motor)
    state = plant.state[0]
    assert np.abs(state["v"][:5]).min() > 0.1
    moving = needed(state["q"], state["v"], state["acceleration"])
    assert np.abs(moving - weight).max() > 5.0
    assert state["parts"]["load"] == pytest.approx(moving, abs=0.02 * np.abs(moving).max())


def test_the_walk_of_the_scatter_goes_on_by_ticks(shipped: Setup) -> None:
    """However many steps the plant takes in a tick, the factors are the same ones, other ones in each tick."""
    setup, seen = with_elements(shipped, scatter=ScatterPart(0.05, 0.02)), []
    for substeps in (1, 3):
        plant = setup.plant(substeps)
        rows = []
        for _ in range(20):
            plant.step(None)
            rows.append(plant.state["parts"]["scatter_factor"][0].copy())
        seen.append(np.array(rows))
    assert np.array_equal(*seen)
    assert np.abs(np.diff(seen[0], axis=0)).min() > 0.0


def test_a_reset_begins_again_to_the_last_bit(arm: Setup) -> None:
    """With all parts the ticks after a reset are those after the first one; another seed's are not."""
    warm = TemperaturePart(40.0, 20.0, 90.0, 30.0, 25.0, 0.05, 10.0, 20.0, 0.3, 0.02, 0.01)
    setup = with_elements(arm, scatter=ScatterPart(0.05, 0.02), temperature=warm)

    def ticks(plant: Plant) -> Array:
        plant.reset(POSE)
        rows = []
        for _ in range(100):
            plant.step(0.3 * setup.drives.peak_torque)
            warmth = plant.temperatures.now, plant.temperatures.heat
            rows.append(np.concatenate([snapshot(plant), plant.friction_states()[2], *warmth]))
        assert np.ptp(plant.temperatures.now) > 0.01
        return np.array(rows)

    plant = setup.plant()
    first = ticks(plant)
    assert np.array_equal(ticks(plant), first)
    assert np.array_equal(ticks(setup.plant()), first)
    assert not np.array_equal(ticks(dataclasses.replace(setup, seed=1).plant()), first)
