"""The drives as seen from the joints: their measurements there, and the motor torques for commanded joint efforts."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.base.rates import Rates, ticks_per
from rx90_common.description.coupling import to_joint, to_joint_torque, to_motor_torque
from rx90_common.kernels.compiled import kernel
from rx90_sim.plant import Plant


class JointInterface:
    """Joint positions, velocities and efforts of an arm whose motors alone are measured and driven.

    A motor may turn with several joints, as motor 6 of the RX family does with joints 5 and 6. Positions and torques
    are transformed so that power is the same on both sides: motor torque times motor velocity is effort times joint
    velocity, summed over the arm.

    Args:
        plant: the arm.
        rates: of the simulation.
        command_hz: how often efforts are commanded, Hz.

    Attributes:
        ticks: base ticks that a command is held for.

    Raises:
        ConfigError: if `command_hz` does not divide the base rate.
    """

    def __init__(self, plant: Plant, rates: Rates, command_hz: int) -> None:
        self.ticks = ticks_per("command_rate", rates.base_hz, command_hz)
        self._plant, joints = plant.constants, len(plant.joint_names)
        self._motor_states = plant.motor_states()
        self._measured = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._torques = np.zeros(joints)
        self.measure()

    def measure(self) -> tuple[Array, Array, Array]:
        """Return position by encoders rad, observed velocity rad/s, torque by current sensors Nm, all at the joints.

        Shape (n,); always the same arrays, brought up to date by this call.
        """
        _to_joints(self._plant, *self._motor_states, *self._measured)
        return self._measured

    def motor_torques(self, effort: Array) -> Array:
        """Return the motor torques, motor side, that make efforts at the joints, Nm, shape (n,).

        Always the same array, which the next call overwrites.
        """
        _to_motors(self._plant, effort, self._torques)
        return self._torques


@kernel
def _to_joints(
    plants: Record, of_motor: Array, speed: Array, torque: Array, position: Array, velocity: Array, effort: Array
) -> None:
    to_joint(plants[0].gear, of_motor, position)
    to_joint(plants[0].gear, speed, velocity)
    to_joint_torque(plants[0].gear, torque, effort)


@kernel
def _to_motors(plants: Record, effort: Array, torque: Array) -> None:
    to_motor_torque(plants[0].gear, effort, torque)
