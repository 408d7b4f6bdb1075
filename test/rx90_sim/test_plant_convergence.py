"""The plant step against a stiff variable-step solver of the same equations."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

Array = NDArray[np.float64]

POSE = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])


def snapshot(plant: Plant) -> Array:
    """Return (q, v, z), shape (19,)."""
    state = plant.state[0]
    return np.concatenate([state["q"], state["v"], state["z"]])


def lopsided(friction: FrictionSet) -> FrictionSet:
    """Return the set with other Coulomb and static torques for negative velocities."""
    elements = tuple(
        dataclasses.replace(e, tau_c_negative=1.3 * e.tau_c_positive, tau_s_negative=1.5 * e.tau_s_positive)
        for e in friction.elements
    )
    return FrictionSet(friction.names, elements)


def test_second_order_for_the_whole_arm(shipped: Setup, arm_oracle: Any) -> None:
    """Under torques that jump and reverse position, velocity and bristles converge with order 2."""
    setup = dataclasses.replace(shipped, friction=lopsided(shipped.friction))
    oracle = dataclasses.replace(arm_oracle, setup=setup)
    rng = np.random.default_rng(1)
    pieces = [part * shipped.drives.peak_torque for part in rng.uniform(-0.5, 0.5, (3, 6))]
    ticks, state = 60, np.concatenate([POSE, np.zeros(13)])
    want = []
    for motor in pieces:
        state = oracle.integrate(state, motor, ticks * setup.rates.period, 1e-9)
        want.append(state)
    velocities = np.array(want)[:, 6:12]
    assert np.any(velocities[:-1] * velocities[1:] < 0)

    counts, errors = np.array([1, 2, 4, 8]), []
    for substeps in counts:
        plant = setup.plant(int(substeps))
        plant.reset(POSE)
        got = []
        for motor in pieces:
            for _ in range(ticks):
                plant.step(motor)
            got.append(snapshot(plant))
        miss = np.abs(np.array(got) - want)
        errors.append([miss[:, :6].max(), miss[:, 6:12].max(), miss[:, 12:].max()])
    position, velocity, bristle = -np.polyfit(np.log(counts), np.log(np.array(errors)), 1)[0]
    assert position == pytest.approx(2.0, abs=0.4)
    assert velocity == pytest.approx(2.0, abs=0.4)
    assert bristle == pytest.approx(2.0, abs=0.4)
    # rad, rad/s, rad at the default of one step in a tick, half the peak torque switched at once
    assert np.all(np.array(errors[0]) < [3e-5, 1e-3, 1e-6])


def test_smooth_torques_held_tick_by_tick(shipped: Setup, arm_oracle: Any) -> None:
    """With torques that change tick by tick, as a controller gives them, the error stays below 10 urad."""
    ticks = 120
    _, gravity = arm_oracle.mass_and_bias(POSE, np.zeros(6))
    share = np.array([40.0, 45.0, -25.0, 9.0, -6.0, 4.0])
    to_joint = np.array([arm_oracle.joint_torque(row) for row in np.eye(6)]).T
    plant = shipped.plant()
    plant.reset(POSE)
    state = np.concatenate([POSE, np.zeros(13)])
    worst = 0.0
    for k in range(ticks):
        swing = math.sin(2 * math.pi * k / ticks)
        motor = np.linalg.solve(to_joint, gravity + share * swing)
        state = arm_oracle.integrate(state, motor, shipped.rates.period, 1e-8)
        plant.step(motor)
        worst = max(worst, np.abs(plant.joint_states()[0] - state[:6]).max())
    assert np.abs(state[6:12]).max() > 0.05
    assert worst < 1e-5


def test_bristles_far_faster_than_the_tick_stay_stable(shipped: Setup) -> None:
    """With bristle rates of hundreds per tick friction equals the Stribeck curve and does not ring."""
    stiff = tuple(dataclasses.replace(e, c0=100 * e.c0, c1=0.0) for e in shipped.friction.elements)
    setup = dataclasses.replace(shipped, friction=FrictionSet(shipped.friction.names, stiff))
    plant = setup.plant()
    plant.state["v"][0] = 0.9 * shipped.robot.max_velocity * [1, -1, 1, 1, -1, 1]
    torques = []
    for _ in range(40):
        plant.step(np.zeros(6))
        _, velocity, torque = plant.friction_states()
        torques.append(torque.copy())
    for i, element in enumerate(stiff):
        assert torque[i] == pytest.approx(element.steady_torque(velocity[i]), rel=1e-3)
    # Free of ringing: each torque runs one way as the arm slows down.
    turns = np.diff(np.sign(np.diff(np.array(torques)[5:], axis=0)), axis=0)
    assert np.count_nonzero(turns) <= 7
