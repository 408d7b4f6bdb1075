"""The whole plant without a controller: torques of every tick, bristles faster than a tick, energy without friction."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from rx90_common.friction import FrictionSet
from rx90_emulator.loop.setup import Setup

POSE = np.array([0.4, 0.9, -0.6, 0.5, 0.3, -0.3])


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
        state = arm_oracle.integrate(state, motor, shipped.rates.period, 1e-8, "LSODA")
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


def test_energy_is_kept_without_friction_to_second_order(
    shipped: Setup, frictionless: FrictionSet, arm_oracle: Any
) -> None:
    """A free arm keeps its energy, spring and rotors included; the error falls fourfold per halving."""
    setup = dataclasses.replace(shipped, friction=frictionless)
    drift, counts = [], np.array([1, 2, 4, 8])
    for substeps in counts:
        plant = setup.plant(int(substeps))
        plant.reset(POSE)
        start = arm_oracle.energy(POSE, np.zeros(6))
        worst = 0.0
        for k in range(1600):
            plant.step(np.zeros(6))
            if k % 16 == 15:
                q, v, _ = plant.joint_states()
                worst = max(worst, abs(arm_oracle.energy(q, v) - start))
        drift.append(worst)
        assert np.all(q > setup.robot.lower + 0.1)
        assert np.all(q < setup.robot.upper - 0.1)
    _, v, _ = plant.joint_states()
    kinetic = 0.5 * v @ arm_oracle.mass_and_bias(q, v)[0] @ v
    assert kinetic > 10.0
    assert -np.polyfit(np.log(counts), np.log(drift), 1)[0] == pytest.approx(2.0, abs=0.25)
    assert drift[0] < 1e-3 * kinetic
