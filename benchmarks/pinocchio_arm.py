"""The same plant stepped with Pinocchio from Python: the arm by Pinocchio, friction and drives in numpy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dposv

from rx90_common.description.wrist import element_matrix
from rx90_common.friction.curves import LINEAR_SPEED
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
_ELEMENT_INPUT = element_matrix()
"""Input velocities of the friction elements for joint velocities."""


class PinocchioArm:
    """Semi-implicit Euler steps of the arm, the bristles exact for the velocity at the start of a step.

    Attributes:
        q: joint positions, rad.
        v: joint velocities, rad/s.
        z: bristle deflections, rad, shape (7,).
    """

    def __init__(self, setup: Setup, position: ArrayLike) -> None:
        self._model = setup.robot.model
        self._data = self._model.createData()
        # Rotor 6 couples joints 5 and 6, which Pinocchio's armature, a diagonal, and with it aba, cannot say.
        self._rotor = setup.drives.rotor_matrix
        self._spring = setup.drives.spring_torque
        self._to_joint = _ELEMENT_INPUT[[0, 1, 2, 3, 4, 6]].T * setup.drives.gear
        self._period = setup.rates.period
        elements = setup.friction.elements
        self._c0, self._c1, self._c2, self._alpha, self._omega_s, self._omega_d, self._delta = np.array(
            [(e.c0, e.c1, e.c2, e.alpha, e.omega_s, e.omega_d, e.delta) for e in elements]
        ).T
        self._coulomb = np.array([(e.tau_c_positive, e.tau_c_negative) for e in elements]).T
        self._static = np.array([(e.tau_s_positive, e.tau_s_negative) for e in elements]).T
        self.q, self.v, self.z = np.array(position, dtype=np.float64), np.zeros(6), np.zeros(7)

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M, its upper triangle alone, shape (6, 6), and h with gravity and spring, shape (6,)."""
        mass = pin.crba(self._model, self._data, q) + self._rotor
        bias = pin.nonLinearEffects(self._model, self._data, q, v)
        bias += self._spring * np.sin(q)
        return mass, bias

    def step(self, motor: Sequence[float]) -> None:
        """Hold motor torques, Nm, for one tick."""
        torque = self._to_joint @ motor - _ELEMENT_INPUT.T @ self._friction(_ELEMENT_INPUT @ self.v)
        mass, bias = self.mass_and_bias(self.q, self.v)
        _, acceleration, _ = dposv(mass, torque - bias)
        self.v += self._period * acceleration
        self.q += self._period * self.v

    def _friction(self, velocity: Array) -> Array:
        """Advance the bristles; return equation 18, Nm, its mean over the step."""
        forward, speed = velocity >= 0, np.abs(velocity)
        coulomb = np.where(forward, self._coulomb[0], self._coulomb[1])
        static = np.where(forward, self._static[0], self._static[1])
        sliding = coulomb + (static - coulomb) * np.exp(-((speed / self._omega_s) ** self._delta))
        x = self._c0 * speed / sliding * self._period + 1e-12  # kept from 0, where 0 / 0 would follow
        z_dot = velocity - self._c0 * speed / sliding * self.z
        phi = -np.expm1(-x) / x
        advance = self._period * z_dot * phi
        mean = self.z + self._period * z_dot * (1.0 - phi) / x
        self.z = self.z + advance
        damping = self._c1 * np.exp(-((velocity / self._omega_d) ** 2))
        viscous = self._c2 * velocity * np.maximum(speed, LINEAR_SPEED) ** (self._alpha - 1.0)
        return np.asarray(self._c0 * mean + damping * z_dot * phi + viscous)
