"""The wrist coupling of the RX family, in one place: motor 6 turns with joints 5 and 6 together.

q_m5 = n5 q5 and q_m6 = n6 (q5 + q6), hence tau5 = n5 tau_m5 + n6 tau_m6 and tau6 = n6 tau_m6. The same
sum drives friction element 7, whose torque acts on both joints.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rx90_common.kernels.compiled import kernel


@kernel
def to_motor(gear: NDArray[np.float64], joint: NDArray[np.float64], motor: NDArray[np.float64]) -> None:
    """Write motor positions (or velocities) for joint positions (or velocities), all shape (6,)."""
    for i in range(5):
        motor[i] = gear[i] * joint[i]
    motor[5] = gear[5] * (joint[4] + joint[5])


@kernel
def to_joint(gear: NDArray[np.float64], motor: NDArray[np.float64], joint: NDArray[np.float64]) -> None:
    """Write joint positions (or velocities) for motor positions (or velocities), all shape (6,)."""
    for i in range(5):
        joint[i] = motor[i] / gear[i]
    joint[5] = motor[5] / gear[5] - joint[4]


@kernel
def to_joint_torque(gear: NDArray[np.float64], motor: NDArray[np.float64], joint: NDArray[np.float64]) -> None:
    """Write the joint torques that motor torques make, all shape (6,), Nm."""
    for i in range(6):
        joint[i] = gear[i] * motor[i]
    joint[4] += joint[5]


@kernel
def to_motor_torque(gear: NDArray[np.float64], joint: NDArray[np.float64], motor: NDArray[np.float64]) -> None:
    """Write the motor torques that make joint torques, all shape (6,), Nm."""
    for i in range(6):
        motor[i] = joint[i] / gear[i]
    motor[4] = (joint[4] - joint[5]) / gear[4]


def coupling_matrix() -> NDArray[np.float64]:
    """Return motor turns for joint turns without the gears, shape (6, 6)."""
    coupling = np.eye(6)
    coupling[5, 4] = 1.0
    return coupling


def element_matrix() -> NDArray[np.float64]:
    """Return input velocities of the seven friction elements for joint velocities, shape (7, 6)."""
    return np.vstack([np.eye(6), coupling_matrix()[5]])


def coupled_inertia(rotor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotors' share of the mass matrix, shape (6, 6), for joint-side rotor inertias, kg m^2.

    Rotor 6 turns with q5 + q6, so its inertia appears in M55, M56, M65 and M66.
    """
    coupling = coupling_matrix()
    return np.asarray(coupling.T @ np.diag(rotor) @ coupling)
