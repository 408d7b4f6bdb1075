"""Elements as compiled code has them, side by side, and the bristle that follows the load below break-away."""

from typing import Any

import numba
import numpy as np
import pytest
from bristle_oracles import random_element

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.compiled_elements import element_arrays, load_elements, one_element, prescribed_torque
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
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


PLAIN = FrictionElement(tau_c=25.0, tau_s=28.0, omega_s=0.05, delta=1.0, c0=1e5, c1=100.0, c2=14.0)


@pytest.mark.parametrize(
    "bristles", [ElastoPlastic(break_away=0.7), MaxwellSlip(stiffness=(0.6, 0.4), share=(0.7, 0.3), attraction=5000.0)]
)
def test_other_bristles_are_springs_below_break_away(bristles: BristlesPart) -> None:
    """Below break-away the mean torque of a step is c0 x + (c1 + c2) v in its middle; LuGre's beside it bends."""
    steps = np.full(400, 1e-3)
    steps[[0, 200]] = 0.0
    time = np.cumsum(steps)
    velocity = np.where(steps > 0.0, 2e-4 * np.pi * np.cos(2.0 * np.pi * 5.0 * time), 0.0)
    middle = np.cumsum(velocity * steps) - 0.5 * velocity * steps
    elements = (PLAIN, PLAIN.replaced(bristles=bristles))
    lugre, other = prescribed_torque(elements, np.column_stack([velocity, velocity]), steps).T
    exact = 1e5 * middle + (100.0 + 14.0) * velocity
    assert np.ptp(exact) > 3.0
    assert other == pytest.approx(exact, abs=1e-9)
    assert np.abs(lugre - exact).max() > 1e-3
