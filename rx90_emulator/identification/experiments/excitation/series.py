"""Finite Fourier series of joint motions that begin and end each period at rest.

Swevers, Ganseman, Tükel, de Schutter and Van Brussel 1997, "Optimal robot excitation and identification": periodic,
band-limited motions, one series for each joint on a common base frequency. Velocity and acceleration at the ends of a
period are zero here, which takes two of a joint's coefficients, so that no ramp is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import null_space

from rx90_common.base.arrays import Array
from rx90_emulator.identification.experiments.motion import Motion

_KNOT_ANGLE = 0.3  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-7 of its size


@dataclass(frozen=True, eq=False)
class SeriesBasis:
    """Motions of given harmonics at sample times, linear in c = 2 H - 1 coefficients of each joint.

    The first coefficient is the middle of the motion, rad; the others are in rad/s.

    Attributes:
        harmonics: H, 3 or more.
        period: s.
        time: of the samples, s, shape (m,).
    """

    harmonics: int
    period: float
    time: Array

    @property
    def count(self) -> int:
        """Return c."""
        return 2 * self.harmonics - 1

    @cached_property
    def matrices(self) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration per coefficient, each of shape (m, c)."""
        number = np.arange(1, self.harmonics + 1)
        omega = 2.0 * math.pi * number / self.period
        # Speed a cos + b sin: at rest where the sum of a is zero, without acceleration where that of omega b is.
        cosine, sine = null_space(np.ones((1, self.harmonics))), null_space(number[None, :].astype(np.float64))
        c, s = np.cos(np.outer(self.time, omega)), np.sin(np.outer(self.time, omega))
        middle = np.ones((len(self.time), 1))
        position = np.hstack([middle, (s / omega) @ cosine, (-c / omega) @ sine])
        velocity = np.hstack([0.0 * middle, c @ cosine, s @ sine])
        acceleration = np.hstack([0.0 * middle, (-s * omega) @ cosine, (c * omega) @ sine])
        return position, velocity, acceleration

    def motion(self, coefficients: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration, each of shape (m, n), for coefficients of shape (n, c)."""
        position, velocity, acceleration = (matrix @ coefficients.T for matrix in self.matrices)
        return position, velocity, acceleration

    def gradient(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return derivatives by the coefficients, shape (n, c), from those by the motion, each of shape (m, n)."""
        p, v, a = self.matrices
        return np.asarray(position.T @ p + velocity.T @ v + acceleration.T @ a)

    def at(self, time: Array) -> SeriesBasis:
        """Return the same motions at other times, s."""
        return SeriesBasis(self.harmonics, self.period, time)


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """A motion of n joints.

    Attributes:
        harmonics: H.
        period: s.
        coefficients: of `SeriesBasis`, shape (n, 2 H - 1).
    """

    harmonics: int
    period: float
    coefficients: Array

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration at times, each of shape (m, n)."""
        return SeriesBasis(self.harmonics, self.period, time).motion(self.coefficients)

    def shrunk(self, factor: float) -> FourierSeries:
        """Return the motion with another size around the same middle."""
        coefficients = self.coefficients * factor
        coefficients[:, 0] = self.coefficients[:, 0]
        return FourierSeries(self.harmonics, self.period, coefficients)

    def add_to(self, motion: Motion, periods: int) -> None:
        """Let a motion that rests where the series begins follow it for some periods."""
        fastest = 2.0 * math.pi * self.harmonics / self.period
        count = math.ceil(self.period * periods * fastest / _KNOT_ANGLE)
        # Knots lie on set-points.
        time = np.unique(np.round(np.linspace(0.0, self.period * periods, count + 1), 3))
        position, velocity, acceleration = self.at(time)
        motion.follow(time[1:], position[1:], velocity[1:], acceleration[1:])
