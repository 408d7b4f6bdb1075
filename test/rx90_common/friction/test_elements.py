"""Seven friction elements in lanes are seven single elements."""

from __future__ import annotations

import dataclasses
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.friction import FrictionSet
from rx90_common.friction.bristle import bristle_step, friction_torque, load_elements
from rx90_common.kernels.lanes import load, store
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
STEP = 2.5e-4


@numba.njit(error_model="numpy")
def together(fields: Any, z: Array, velocity: Array, out: Array) -> None:
    """Write new deflections, mean torques and torques of now, shape (3, 7)."""
    elements, deflection, speed = load_elements(fields[0].friction, 7), load(z, 7), load(velocity, 7)
    new, torque = bristle_step(elements, deflection, speed, STEP)
    store(out[0], new)
    store(out[1], torque)
    store(out[2], friction_torque(elements, deflection, speed))


@pytest.mark.parametrize("deltas", [[1.0] * 7, [2.0] * 7, [1.0, 2.0, 0.5, 1.0, 2.7, 2.0, 1.0]])
def test_the_set_equals_its_elements(shipped: Setup, deltas: list[float]) -> None:
    """Stuck, creeping and sliding either way, each lane gives the bits that its element gives by itself."""
    shaped = [
        dataclasses.replace(element, delta=delta, tau_c_negative=1.1 * element.tau_c_positive, tau_s_negative=60.0)
        for element, delta in zip(shipped.friction.elements, deltas, strict=True)
    ]
    friction = FrictionSet(shipped.friction.names, tuple(shaped))
    plant = dataclasses.replace(shipped, friction=friction).plant()
    rng = np.random.default_rng(11)
    for _ in range(200):
        velocity = rng.choice([-1, 0, 1], 7) * 10.0 ** rng.uniform(-9, 1.5, 7)
        z = rng.uniform(-1e-4, 1e-4, 7)
        out = np.empty((3, 7))
        together(plant.constants, z, velocity, out)
        for i, record in enumerate(friction.records()):
            single = [*bristle_step(record, z[i], velocity[i], STEP), friction_torque(record, z[i], velocity[i])]
            assert out[:, i].tolist() == single
