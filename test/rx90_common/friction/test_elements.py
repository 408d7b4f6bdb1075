"""Seven friction elements in lanes are seven single elements."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.compiled_elements import element_arrays, load_elements
from rx90_common.kernels.lanes import load, store
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
STEP = 2.5e-4
Record = Callable[[FrictionElement], Any]


@numba.njit(error_model="numpy")
def together(arrays: Any, z: Array, velocity: Array, out: Array) -> None:
    """Write new deflections, mean torques and torques of now, shape (3, 7)."""
    elements, deflection, speed = load_elements(arrays[0], 7), load(z, 7), load(velocity, 7)
    new, torque = bristle_step(elements, deflection, speed, STEP)
    store(out[0], new)
    store(out[1], torque)
    store(out[2], friction_torque(elements, deflection, speed))


@pytest.mark.parametrize(
    ("deltas", "alphas"),
    [
        ([1.0] * 7, [1.0] * 7),
        ([2.0] * 7, [0.6] * 7),
        ([1.0, 2.0, 0.5, 1.0, 2.7, 2.0, 1.0], [1.0, 0.7, 1.0, 2.0, 0.3, 1.0, 1.5]),
    ],
)
def test_the_set_equals_its_elements(shipped: Setup, record: Record, deltas: list[float], alphas: list[float]) -> None:
    """Stuck, creeping and sliding either way, each lane gives the bits that its element gives by itself."""
    shaped = [
        dataclasses.replace(
            element, delta=delta, alpha=alpha, tau_c_negative=1.1 * element.tau_c_positive, tau_s_negative=60.0
        )
        for element, delta, alpha in zip(shipped.friction.elements, deltas, alphas, strict=True)
    ]
    arrays = element_arrays(shaped)
    rng = np.random.default_rng(11)
    for _ in range(200):
        velocity = rng.choice([-1, 0, 1], 7) * 10.0 ** rng.uniform(-9, 1.5, 7)
        z = rng.uniform(-1e-4, 1e-4, 7)
        out = np.empty((3, 7))
        together(arrays, z, velocity, out)
        for i, element in enumerate(map(record, shaped)):
            single = [*bristle_step(element, z[i], velocity[i], STEP), friction_torque(element, z[i], velocity[i])]
            assert out[:, i].tolist() == single


def test_the_arrays_hold_each_sign_in_its_row(shipped: Setup) -> None:
    """Torques for v >= 0 stand in the first row and for v < 0 in the second, everything else once, in SI units."""
    element = FrictionElement(2.0, 3.0, 4.0, 5.0, 0.5, 6.0, 7.0, 8.0, 9.0)
    arrays = element_arrays((*shipped.friction.elements, element))[0]
    assert (arrays["tau_c"][:, 7].tolist(), arrays["tau_s"][:, 7].tolist()) == ([2.0, 3.0], [4.0, 5.0])
    rest = [arrays[name][7] for name in ("inverse_omega_s", "delta", "c0", "c1", "c2", "inverse_omega_d", "alpha")]
    assert rest == [2.0, 6.0, 7.0, 8.0, 9.0, 0.0, 1.0]
    assert arrays["tau_c"][1, :7].tolist() == [e.tau_c_negative for e in shipped.friction.elements]
