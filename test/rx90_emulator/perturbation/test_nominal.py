"""M0, C0, K0 and tau0 are those of the arm with rotors and spring, by Pinocchio's inverse dynamics."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from rx90_common.base.rates import Rates
from rx90_common.description.rigid_torque import rigid_torque
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.perturbation.model import linearise, nominal_motion, nominal_torque

Array = NDArray[np.float64]
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
REST = [0.0] * 6


def inverse_dynamics(setup: Setup, q: Array, v: Array, a: Array) -> Array:
    """Return the torque on the joints at one state, shape (6,)."""
    drives = setup.drives
    return rigid_torque(setup.robot.model, drives.rotor_matrix, drives.spring_torque, q[None], v[None], a[None])[0]


def accepted(points: TrajectoryPoints, hold: ArrayLike, start: int, rates: Rates) -> TrajectoryGenerator:
    """Return a generator without limits that follows the points from position tick `start` on."""
    free = np.full(6, np.inf)
    generator = TrajectoryGenerator(JointLimits(NAMES, -free, free, free, free, 1.0), rates.position_period, hold)
    generator.accept(points, 0, start)
    return generator


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


def test_the_nominal_torque_is_the_inverse_dynamics_of_the_motion(shipped: Setup) -> None:
    """In the middle of a step tau0 is what Pinocchio, rotors and spring ask for."""
    plant = shipped.plant()
    rows = [[0.1, 0.3, 1.1, -0.2, 0.7, 0.3], [0.3, 0.1, 1.4, -0.4, 0.8, 0.1]]
    points = TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.3], rows, [REST] * 2, [REST] * 2)
    motion = nominal_motion(accepted(points, rows[0], 2, Rates()), 1600, Rates())
    torque = nominal_torque(plant.constants, plant.state, motion)
    for k in (0, 8, 300, 900, 1599):
        state = motion.middle_position[k], motion.middle_velocity[k], motion.acceleration[k]
        np.testing.assert_allclose(torque[k], inverse_dynamics(shipped, *state), rtol=1e-10, atol=1e-9)


def test_the_nominal_steps_lead_from_set_point_to_set_point(shipped: Setup) -> None:
    """Steps of constant acceleration, and what they slip, add up to the set-points, even where these jump."""
    rates = shipped.rates
    rows = [[0.1, 0.3, 1.1, -0.2, 0.7, 0.3], [0.3, 0.1, 1.4, -0.4, 0.8, 0.1]]
    points = TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.1003], rows, [], [])
    motion = nominal_motion(accepted(points, np.array(rows[0]) + 5e-4, 10, rates), 1000, rates)
    q, v = motion.position[0].copy(), motion.velocity[0].copy()
    for k in range(1000):
        q += rates.period * (v + 0.5 * rates.period * motion.acceleration[k]) + motion.slip[k]
        v += rates.period * motion.acceleration[k]
        np.testing.assert_allclose(q, motion.position[k + 1], atol=1e-12)
        np.testing.assert_allclose(v, motion.velocity[k + 1], atol=1e-9)
    np.testing.assert_allclose(q, rows[1], atol=1e-12)
