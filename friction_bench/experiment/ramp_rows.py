"""The rows of ramps: angles of a sliding shaft, less a model's, so that their errors are independent and of variance 1.

The shaft obeys J w' = tau - f_v w - f_c - delta_s exp(-(w / w_s)^e); the last term is left of a Stribeck effect. With
alpha = 1 / f_v, beta = f_c / f_v, kappa = delta_s / f_v and T = J / f_v (`Sliding`) that is

    T w' + w = alpha tau - beta - kappa exp(-(w / w_s)^e).

An angle differs from it by four things, which `Errors.rows` takes out of a ramp:

- quantisation to counts, which is white;
- torque noise, which makes the angle an integrated Ornstein-Uhlenbeck process with the time constant T;
- the ramp's torque and friction, which differ a little from those of others: alpha and beta have an error of the ramp
  (a linear mixed model);
- angle and velocity at the first reading, which are free, so that break-away and presliding need no model.

Units: w in rad/s at the motor; tau, f_c and delta_s in Nm, f_v in Nm s/rad, J in kg m²; hence alpha in rad/(s Nm),
beta and kappa in rad/s, T in s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from friction_bench.experiment.record import SlidingWindow
from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import kernel


class Sliding(NamedTuple):
    """Parameters of a sliding shaft; velocity w_s and exponent e are those of a Stribeck effect."""

    alpha: float
    beta: float
    T: float
    kappa: float = 0.0
    velocity: float = 1.0
    exponent: float = 1.0


@kernel
def slide(time: Array, torque: Array, speed: float, shaft: Sliding) -> tuple[Array, Array]:
    """Return angle since the first reading, rad, and velocity, rad/s, each shape (n,).

    A step is exact for a constant Stribeck effect, whose mean over the step is found by a first trial.

    Args:
        time: of the readings, s, shape (n,).
        torque: held from each reading to the next, Nm, shape (n,).
        speed: velocity at the first reading, rad/s.
        shaft: its parameters.
    """
    angles = np.zeros(time.size)
    speeds = np.full(time.size, speed)
    for k in range(1, time.size):
        step = time[k] - time[k - 1]
        decay = math.exp(-step / shaft.T)
        drive = shaft.alpha * torque[k - 1] - shaft.beta
        final = drive
        if shaft.kappa > 0.0:
            left = math.exp(-((max(speed, 0.0) / shaft.velocity) ** shaft.exponent))
            final = drive - shaft.kappa * left
            later = final + (speed - final) * decay
            left += math.exp(-((max(later, 0.0) / shaft.velocity) ** shaft.exponent))
            final = drive - shaft.kappa * left / 2.0
        angles[k] = angles[k - 1] + final * step + (speed - final) * shaft.T * (1.0 - decay)
        speed = final + (speed - final) * decay
        speeds[k] = speed
    return angles, speeds


@kernel
def whiten(time: Array, columns: Array, T: float, q: float, r: float) -> tuple[Array, float]:
    """Return columns of angles so that their errors are independent and of variance 1, and the log determinant.

    Errors of the angle are white with the variance r (quantisation), plus the effect of white torque noise on a shaft
    whose angle and velocity at the first reading are known: an integrated Ornstein-Uhlenbeck process. The innovations
    of a Kalman filter for these, divided by their standard deviations, are the columns times the inverse Cholesky
    factor of the covariance.

    Args:
        time: of the readings, s, shape (n,).
        columns: angles, shape (p, n).
        T: time constant, s.
        q: intensity of the torque noise over f_v, (rad/s)² s.
        r: variance of a reading, rad².
    """
    white = np.empty(columns.shape)
    count = columns.shape[0]
    angle = np.zeros(count)
    speed = np.zeros(count)
    aa = ab = bb = 0.0  # covariance of angle and velocity
    determinant = 0.0
    for k in range(time.size):
        if k > 0:
            step = time[k] - time[k - 1]
            e = math.exp(-step / T)
            g = T * (1.0 - e)
            for i in range(count):
                angle[i] += g * speed[i]
                speed[i] *= e
            aa += 2.0 * g * ab + g * g * bb + q * (step - 2.0 * g + T / 2.0 * (1.0 - e * e))
            ab = e * (ab + g * bb) + q * (1.0 - e) ** 2 / 2.0
            bb = e * e * bb + q * (1.0 - e * e) / (2.0 * T)
        variance = aa + r
        deviation = math.sqrt(variance)
        determinant += math.log(variance)
        for i in range(count):
            innovation = columns[i, k] - angle[i]
            white[i, k] = innovation / deviation
            angle[i] += aa / variance * innovation
            speed[i] += ab / variance * innovation
        aa, ab, bb = aa - aa * aa / variance, ab - aa * ab / variance, bb - ab * ab / variance
    return white, determinant


class Alone(NamedTuple):
    """What readings of one ramp tell by themselves.

    Attributes:
        change: of alpha, beta, angle and velocity at the first reading from those of a model, shape (4,).
        covariance: of it by counts and torque noise, shape (4, 4).
        misfit: minus twice the restricted logarithmic likelihood of the noise.
    """

    change: Array
    covariance: Array
    misfit: float


class Errors(NamedTuple):
    """By what angles differ from a model.

    Attributes:
        T: time constant of the torque noise, s.
        noise: intensity of the torque noise over f_v, (rad/s)² s.
        variance: of a reading by quantisation, rad².
        spread: standard deviations of alpha and beta from ramp to ramp, shape (2,).
    """

    T: float
    noise: float
    variance: float
    spread: Array

    def rows(self, window: SlidingWindow, columns: Array) -> Array:
        """Return columns of angles of a ramp, (p, n), with independent errors, whatever its start."""
        time = window.time
        columns = np.vstack([columns, self._of_ramp(time, window.torque)])
        white = whiten(time, columns, self.T, self.noise, self.variance)[0]
        start = np.linalg.qr(white[-2:].T)[0]
        loose = white[-4:-2].T * self.spread
        loose -= start @ (start.T @ loose)
        differing, size, _ = np.linalg.svd(loose, full_matrices=False)
        share = np.concatenate([np.ones(2), 1.0 - 1.0 / np.sqrt(1.0 + size**2)])
        basis = np.hstack([start, differing])
        white = white[:-4]
        return np.asarray(white - (white @ basis * share) @ basis.T)

    def alone(self, time: Array, torque: Array, residual: Array) -> Alone:
        """Return what readings of one ramp tell, from the residual of their angles, each shape (n,)."""
        columns = np.vstack([residual, self._of_ramp(time, torque)])
        white, determinant = whiten(time, columns, self.T, self.noise, self.variance)
        basis, upper = np.linalg.qr(white[1:].T)
        inverse = np.linalg.inv(upper)
        explained = basis.T @ white[0]
        squares = float(white[0] @ white[0] - explained @ explained)
        of_columns = 2.0 * float(np.log(np.abs(np.diag(upper))).sum())
        return Alone(inverse @ explained, inverse @ inverse.T, determinant + of_columns + squares)

    def _of_ramp(self, time: Array, torque: Array) -> Array:
        """Return an angle's derivatives by alpha, beta, angle and velocity at the first reading, shape (4, n)."""
        by_alpha = slide(time, torque, 0.0, Sliding(1.0, 0.0, self.T))[0]
        by_beta = slide(time, torque, 0.0, Sliding(0.0, 1.0, self.T))[0]
        by_speed = -self.T * np.expm1(-(time - time[0]) / self.T)
        return np.array([by_alpha, by_beta, np.ones_like(time), by_speed])
