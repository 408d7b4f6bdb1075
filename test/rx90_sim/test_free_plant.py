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
