"""The rigid arm in compiled code against Pinocchio and against the published check values."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rx90_common.arm_dynamics import body_dtype, inverse_dynamics, manipulator_record, mass_and_bias
from rx90_common.base.arrays import Array
from rx90_common.description.robot import load_robot
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.setup import Setup


def compiled(setup: Setup, q: Array, v: Array) -> tuple[Array, Array]:
    plant = setup.plant()
    mass, bias = np.empty((6, 6)), np.empty(6)
    mass_and_bias(plant.constants[0]["arm"], plant.state[0]["body"], q, v, mass, bias)
    return mass, bias


def inverse(setup: Setup, q: Array, v: Array, a: Array) -> Array:
    body, torque = np.zeros(1, body_dtype(6)), np.empty(6)
    arm = manipulator_record(setup.robot.chain, setup.drives)
    inverse_dynamics(arm[0], body[0], q, v, a, torque)
    return torque


def worst(setup: Setup, rng: np.random.Generator, states: int) -> float:
    """Return by how much M a + h and the inverse dynamics differ from rigid_torque, in parts of the largest torque."""
    low, high = setup.robot.lower, setup.robot.upper
    q, v = rng.uniform(low, high, (states, 6)), rng.uniform(-1, 1, (states, 6)) * setup.robot.max_velocity
    a = rng.uniform(-20.0, 20.0, (states, 6))
    a[::3] = 0.0
    v[1::3] = 0.0
    got = []
    for k in range(states):
        mass, bias = compiled(setup, q[k], v[k])
        assert np.array_equal(mass, mass.T)
        got.append([mass @ a[k] + bias, inverse(setup, q[k], v[k], a[k])])
    want = rigid_torque(setup.robot.model, setup.drives.rotor_matrix, setup.drives.spring_torque, q, v, a)
    return float(np.abs(np.array(got) - want[:, None]).max() / np.abs(want).max())


def test_the_compiled_arm_gives_the_rigid_torque(shipped: Setup) -> None:
    """M a + h, also without M, with rotors, coupling and spring equals rigid_torque to 1e-14 of the largest torque."""
    assert worst(shipped, np.random.default_rng(2), 300) < 1e-14


@pytest.mark.parametrize("seed", range(10))
def test_any_compiled_arm_gives_its_rigid_torque(shipped: Setup, random_arm: Callable[[int], Path], seed: int) -> None:
    """So does an arm with turned frames, skew axes, off-axis masses, a fixed load, other rotors and six springs."""
    rng = np.random.default_rng(seed)
    drives = shipped.drives.replaced(
        transmission={"rotor_inertia": rng.uniform(0.0, 20.0, 6)}, spring={"torque": rng.uniform(0.0, 500.0, 6)}
    )
    assert worst(dataclasses.replace(shipped, robot=load_robot(random_arm(seed)), drives=drives), rng, 60) < 1e-13


def test_inertia_check_values_of_the_parameter_set(shipped: Setup) -> None:
    """The diagonal of M at the published pose is the published one, to the two digits it is printed with."""
    mass, _ = compiled(shipped, np.array([0.0, 0.5, 1.2, 0.0, 0.9, 0.0]), np.zeros(6))
    assert np.diag(mass) == pytest.approx([11.2, 15.6, 3.6, 0.37, 0.29, 0.040], rel=0.015)


def test_gravity_check_values_of_the_parameter_set(shipped: Setup) -> None:
    """With the arm horizontal gravity alone is 238 Nm on joint 2, and the spring leaves 118 Nm of it."""
    horizontal = np.array([0.0, math.pi / 2, 0.0, 0.0, 0.0, 0.0])
    _, bias = compiled(shipped, horizontal, np.zeros(6))
    unsprung = dataclasses.replace(shipped, drives=shipped.drives.replaced(spring={"torque": np.zeros(6)}))
    _, gravity = compiled(unsprung, horizontal, np.zeros(6))
    assert abs(gravity[1]) == pytest.approx(238.0, abs=0.5)
    assert abs(bias[1]) == pytest.approx(118.0, abs=0.5)
    # Gravity pulls the arm down, to larger q2; holding it takes a negative torque.
    assert gravity[1] < 0
    assert gravity[0] == pytest.approx(0.0, abs=1e-12)
