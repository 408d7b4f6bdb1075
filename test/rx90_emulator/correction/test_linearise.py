"""The linearised arm of the norm-optimal method."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_common.base.arrays import Array
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.correction.linearise import linearise
from rx90_emulator.loop.setup import Setup


def inverse_dynamics(setup: Setup, q: Array, v: Array, a: Array) -> Array:
    """Return the torque on the joints at one state, shape (6,)."""
    drives = setup.drives
    return rigid_torque(setup.robot.model, drives.rotor_matrix, drives.spring_torque, q[None], v[None], a[None])[0]


def slopes(setup: Setup, state: Array, which: int, step: float = 1e-5) -> Array:
    """Return the derivative of the torque by position, velocity or acceleration, by central differences."""
    columns = []
    for joint in range(6):
        move = np.zeros((3, 6))
        move[which, joint] = step
        difference = inverse_dynamics(setup, *(state + move)) - inverse_dynamics(setup, *(state - move))
        columns.append(difference / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_equal_differences_of_the_inverse_dynamics(shipped: Setup, seed: int) -> None:
    """M0, C0 and K0 are the slopes of the torque, rotors, wrist coupling, gravity and spring included."""
    rng = np.random.default_rng(seed)
    state = np.stack([rng.uniform(-2.0, 2.0, 6), rng.uniform(-3.0, 3.0, 6), rng.uniform(-20.0, 20.0, 6)])
    linear = linearise(shipped.robot, shipped.drives, *state[:, None])
    for ours, which in ((linear.stiffness, 0), (linear.damping, 1), (linear.mass, 2)):
        expected = slopes(shipped, state, which)
        np.testing.assert_allclose(ours[0], expected, rtol=0, atol=1e-6 * np.abs(expected).max())
