"""The nominal motion: set-points as a prescribed motion of the joints, its torques, and the arm linearised about it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array, Record
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.dynamics.manipulator import mass_and_bias
from rx90_common.kernels.compiled import kernel
from rx90_controller.trajectory import TrajectoryGenerator


class NominalMotion(NamedTuple):
    """A prescribed motion over n base ticks, in steps of constant acceleration between their ends.

    Attributes:
        position: q0 on ticks, rad, shape (n + 1, 6).
        velocity: v0 on ticks, rad/s, shape (n + 1, 6).
        middle_position: q0 in the middle of the steps, rad, shape (n, 6).
        middle_velocity: v0 there, rad/s, shape (n, 6).
        acceleration: mean over the steps, rad/s^2, shape (n, 6).
        slip: by how much a step of constant acceleration falls short of the next position, rad, shape (n, 6).
    """

    position: Array
    velocity: Array
    middle_position: Array
    middle_velocity: Array
    acceleration: Array
    slip: Array


def nominal_motion(trajectory: TrajectoryGenerator, ticks: int, rates: Rates) -> NominalMotion:
    """Return the motion of the set-points on base ticks.

    Args:
        trajectory: the generator that has accepted the motion, on ticks of the position loop.
        ticks: length of the motion in base ticks.
        rates: rates of the loops.
    """
    generator = trajectory.refined(rates.ratio)
    position, velocity, _ = np.moveaxis(generator.setpoints(0, ticks + 1), 1, 0)
    step = rates.period
    acceleration = np.diff(velocity, axis=0) / step
    return NominalMotion(
        position=np.ascontiguousarray(position),
        velocity=np.ascontiguousarray(velocity),
        middle_position=position[:-1] + 0.5 * step * (velocity[:-1] + 0.25 * step * acceleration),
        middle_velocity=0.5 * (velocity[:-1] + velocity[1:]),
        acceleration=acceleration,
        slip=np.diff(position, axis=0) - 0.5 * step * (velocity[:-1] + velocity[1:]),
    )


def nominal_torque(plants: Record, states: Record, motion: NominalMotion) -> Array:
    """Return tau0 = M a0 + h without friction in the middle of the steps, Nm, shape (n, 6).

    Args:
        plants: constants of the plant, shape (1,), PLANT_DTYPE.
        states: state of a plant, shape (1,), STATE_DTYPE; its workspace is overwritten.
        motion: the nominal motion.
    """
    torque = np.empty_like(motion.acceleration)
    _inverse_dynamics(plants, states, motion.middle_position, motion.middle_velocity, motion.acceleration, torque)
    return torque


@kernel
def _inverse_dynamics(
    plants: Record, states: Record, position: Array, velocity: Array, acceleration: Array, torque: Array
) -> None:
    plant, state = plants[0], states[0]
    for k in range(len(torque)):
        mass_and_bias(plant.arm, state.body, position[k], velocity[k], state.mass_matrix, state.bias)
        for i in range(6):
            torque[k, i] = state.bias[i]
            for j in range(6):
                torque[k, i] += state.mass_matrix[i, j] * acceleration[k, j]


class Linearisation(NamedTuple):
    """Derivatives of the inverse dynamics M a + h along a motion.

    Attributes:
        mass: M0 = M(q0), rotors included, kg m^2, shape (n, 6, 6).
        damping: C0 = dh/dv, Nm s/rad, shape (n, 6, 6).
        stiffness: K0 = d(M a0 + h)/dq, gravity and spring included, Nm/rad, shape (n, 6, 6).
    """

    mass: Array
    damping: Array
    stiffness: Array

    def for_steps(self) -> Array:
        """Return the inverse of M0, C0 and K0 as steps use them, shape (n, 3, 6, 6)."""
        return np.ascontiguousarray(np.stack([np.linalg.inv(self.mass), self.damping, self.stiffness], axis=1))


def linearise(
    robot: RobotModel, drives: DriveParameters, position: Array, velocity: Array, acceleration: Array
) -> Linearisation:
    """Return M0, C0 and K0 at n points of a motion.

    Args:
        robot: the arm with its tool.
        drives: rotors and spring.
        position: rad, shape (n, 6).
        velocity: rad/s, shape (n, 6).
        acceleration: rad/s^2, shape (n, 6).
    """
    data = robot.model.createData()
    count = len(position)
    mass, damping, stiffness = (np.empty((count, 6, 6)) for _ in range(3))
    for n, state in enumerate(zip(position, velocity, acceleration, strict=True)):
        by_position, by_velocity, by_acceleration = pin.computeRNEADerivatives(robot.model, data, *state)
        upper = np.triu(by_acceleration)
        mass[n] = upper + np.triu(upper, 1).T
        damping[n], stiffness[n] = by_velocity, by_position
    # The rotors' inertia is the same in every pose, so it adds to M0 alone; the spring gives k cos(q) to K0.
    mass += drives.rotor_matrix
    joints = np.arange(6)
    stiffness[:, joints, joints] += drives.spring_torque * np.cos(position)
    return Linearisation(mass, damping, stiffness)
