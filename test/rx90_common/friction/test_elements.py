"""Elements as compiled code has them, side by side."""

from typing import Any

import numba
import numpy as np
import pytest
from bristle_oracles import random_element
from lugre_oracle import one_element

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.compiled_elements import element_arrays, load_elements
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.kernels.lanes import load, store

STEP = 2.5e-4


@numba.njit(error_model="numpy")
def together(arrays: Any, break_away: Array, z: Array, velocity: Array, out: Array) -> None:
    """Write new deflections, mean torques and torques of now of LuGre's bristles and of elasto-plastic ones, (6, 7)."""
    elements, away, deflection, speed = load_elements(arrays[0], 7), load(break_away, 7), load(z, 7), load(velocity, 7)
    new, torque = bristle_step(elements, deflection, speed, STEP)
    store(out[0], new)
    store(out[1], torque)
    store(out[2], friction_torque(elements, deflection, speed))
    new, torque = elasto_plastic_step(elements, away, deflection, speed, STEP)
    store(out[3], new)
    store(out[4], torque)
    store(out[5], elasto_plastic_torque(elements, away, deflection, speed))


@pytest.mark.parametrize(
    ("deltas", "alphas"),
    [
        ([1.0] * 7, [1.0] * 7),
        ([2.0] * 7, [0.6] * 7),
        ([1.0, 2.0, 0.5, 1.0, 2.7, 2.0, 1.0], [1.0, 0.7, 1.0, 2.0, 0.3, 1.0, 1.5]),
    ],
)
def test_the_set_equals_its_elements(deltas: list[float], alphas: list[float]) -> None:
    """Stuck, creeping, in transition and sliding either way, a lane gives the bits that its element gives by itself."""
    rng = np.random.default_rng(11)
    elements = [
        random_element(rng).replaced(delta=delta, alpha=alpha) for delta, alpha in zip(deltas, alphas, strict=True)
    ]
    arrays, out = element_arrays(elements), np.empty((6, 7))
    for _ in range(200):
        velocity = rng.choice([-1, 0, 1], 7) * 10.0 ** rng.uniform(-9, 1.5, 7)
        z = rng.uniform(-1.0, 1.0, 7) * [e.tau_c.positive / e.c0 for e in elements]
        away = rng.uniform(0.0, 0.9, 7)
        together(arrays, away, z, velocity, out)
        for i in range(7):
            one, at = one_element(arrays[0], i), (z[i], velocity[i])
            single = [*bristle_step(one, *at, STEP), friction_torque(one, *at)]
            single += [*elasto_plastic_step(one, away[i], *at, STEP), elasto_plastic_torque(one, away[i], *at)]
            assert out[:, i].tolist() == single
