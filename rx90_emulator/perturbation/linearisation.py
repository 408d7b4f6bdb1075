"""M0, C0 and K0 of the arm along a motion, from Pinocchio's derivatives of the inverse dynamics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel

Array = NDArray[np.float64]


class Linearisation(NamedTuple):
    """How the drive torque of the inverse dynamics M a + h answers to small deviations of a motion.

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
    stiffness[:, joints, joints] += drives.spring * np.cos(position)
    return Linearisation(mass, damping, stiffness)
