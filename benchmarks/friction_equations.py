"""Friction of one element in plain NumPy, straight from the equations: nothing of the code under test is in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrictionLaw:
    """Coulomb, Stribeck and viscous friction with an exponent, and a bristle where `c0` is not 0.

        c0 g(v) = tau_c(sign v) (1 + rise exp(-(|v| / omega_s)^delta)) (1 + load)
        tau = sign(v) c0 g(v) + c2 |v|^alpha sign(v)                      without a bristle
        dz/dt = v - |v| / g(v) z,  tau = c0 z + c1 dz/dt + c2 |v|^alpha sign(v)      with one

    Attributes:
        tau_c: Coulomb torque for v > 0 and for v < 0, Nm.
        c2: viscous torque at 1 rad/s, Nm.
        alpha: viscous exponent.
        rise: static over Coulomb torque, less 1.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent.
        c0: bristle stiffness, Nm/rad; 0 for none.
        c1: micro-viscous damping, Nm s/rad.
    """

    tau_c: tuple[float, float]
    c2: float
    alpha: float = 1.0
    rise: float = 0.0
    omega_s: float = 0.1
    delta: float = 1.0
    c0: float = 0.0
    c1: float = 0.0

    @property
    def coulomb(self) -> float:
        """Return the mean of both Coulomb torques, Nm."""
        return sum(self.tau_c) / 2.0

    @property
    def asymmetry(self) -> float:
        """Return half the difference of the Coulomb torques, Nm: of a part without Stribeck effect a constant."""
        return (self.tau_c[0] - self.tau_c[1]) / 2.0

    def sliding(self, velocity: Array, load: Array | float = 0.0) -> Array:
        """Return c0 g(v), Nm; `load` is the relative change of the Coulomb torque."""
        coulomb = np.where(velocity >= 0.0, *self.tau_c)
        stribeck = 1.0 + self.rise * np.exp(-((np.abs(velocity) / self.omega_s) ** self.delta))
        return np.asarray(coulomb * stribeck * (1.0 + load))

    def viscous(self, velocity: Array) -> Array:
        """Return c2 |v|^alpha sign(v), Nm."""
        return np.asarray(self.c2 * np.abs(velocity) ** self.alpha * np.sign(velocity))

    def steady(self, velocity: Array, load: Array | float = 0.0) -> Array:
        """Return the torque without a bristle, Nm."""
        return np.sign(velocity) * self.sliding(velocity, load) + self.viscous(velocity)

    def torque(self, time: Array, velocity: Array, load: Array | float = 0.0, substeps: int = 8) -> Array:
        """Return the torque along a motion from rest, Nm, all of shape (m,).

        Over a part of a step, in which the velocity keeps its middle value, equation 17 has an exponential for its
        solution; the chain of them is a bidiagonal system.
        """
        if not self.c0:
            return self.steady(velocity, load)
        fine = np.interp(np.arange((len(time) - 1) * substeps + 1) / substeps, np.arange(len(time)), time)
        middle, step = (fine[1:] + fine[:-1]) / 2.0, np.diff(fine)
        v = np.interp(middle, time, velocity)
        loaded = np.interp(middle, time, np.broadcast_to(load, time.shape))
        limit = self.sliding(v, loaded) / self.c0
        decay = np.exp(-np.abs(v) * step / limit)
        bands = np.vstack([np.ones(len(fine)), np.append(-decay, 0.0)])
        z = solve_banded((1, 0), bands, np.append(0.0, np.sign(v) * limit * (1.0 - decay)))[::substeps]
        rate = velocity - np.abs(velocity) * self.c0 / self.sliding(velocity, load) * z
        return self.c0 * z + self.c1 * rate + self.viscous(velocity)
