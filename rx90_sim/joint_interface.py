"""The drives seen from the joints: what they measure there, and the motor torques that joint efforts ask for."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates, ticks_per
from rx90_common.description.drives import to_joint, to_joint_torque, to_motor_torque
from rx90_sim.plant import Plant


class JointInterface:
    """Joint positions, velocities and efforts of an arm whose motors alone are measured and driven.

    Motor 6 turns with joints 5 and 6 together. Positions and torques are transformed so that power is the same on both
    sides: motor torque times motor velocity is effort times joint velocity, summed over the arm.

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
        self._gear = np.ascontiguousarray(plant.constants["gear"][0])
        self._motor_states = plant.motor_states()
        self._measured = np.zeros(6), np.zeros(6), np.zeros(6)
        self._torques = np.zeros(6)
        self.measure()

    def measure(self) -> tuple[Array, Array, Array]:
        """Return position by encoders rad, observed velocity rad/s, torque by current sensors Nm, all at the joints.

        Shape (6,); always the same arrays, brought up to date by this call.
        """
        (position, velocity, effort), (of_motor, speed, torque) = self._measured, self._motor_states
        to_joint(self._gear, of_motor, position)
        to_joint(self._gear, speed, velocity)
        to_joint_torque(self._gear, torque, effort)
        return self._measured

    def motor_torques(self, effort: Array) -> Array:
        """Return the motor torques, motor side, that make efforts at the joints, Nm, shape (6,).

        Always the same array, which the next call overwrites.
        """
        to_motor_torque(self._gear, effort, self._torques)
        return self._torques
