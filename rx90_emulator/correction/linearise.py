"""Derivatives of the inverse dynamics along a motion, of which the response of the joints to offsets is made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel

SPACING = 0.01
"""From one point of the linearisation to the next, s."""


class Linearisation(NamedTuple):
    """Derivatives of the inverse dynamics M a + h along a motion; h holds Coriolis, centrifugal and gravity torques.

    Attributes:
        mass: M0 = M(q0), rotors included, kg m^2, shape (n, joints, joints).
        damping: C0 = dh/dv, Nm s/rad, shape (n, joints, joints).
        stiffness: K0 = d(M a0 + h)/dq, gravity and spring included, Nm/rad, shape (n, joints, joints).
    """

    mass: Array
    damping: Array
    stiffness: Array


def linearise(
    robot: RobotModel,
    drives: DriveParameters,
    position: Array,
    velocity: Array,
    acceleration: Array,
) -> Linearisation:
    """Return M0, C0 and K0 at n points of a motion.

    Args:
        robot: the arm with its tool.
        drives: rotors and spring.
        position: rad, shape (n, joints).
        velocity: rad/s, shape (n, joints).
        acceleration: rad/s^2, shape (n, joints).
    """
    data = robot.model.createData()
    count, joints = position.shape
    mass = np.empty((count, joints, joints))
    damping = np.empty_like(mass)
    stiffness = np.empty_like(mass)
    for n, state in enumerate(zip(position, velocity, acceleration, strict=True)):
        by_position, by_velocity, by_acceleration = pin.computeRNEADerivatives(
            robot.model, data, *state
        )
        upper = np.triu(by_acceleration)
        mass[n] = upper + np.triu(upper, 1).T
        damping[n] = by_velocity
        stiffness[n] = by_position
    # The rotors' inertia is the same in every pose, so it adds to M0 alone; the spring gives k cos(q) to K0.
    mass += drives.rotor_matrix
    diagonal = np.arange(joints)
    stiffness[:, diagonal, diagonal] += drives.spring_torque * np.cos(position)
    return Linearisation(mass, damping, stiffness)
