"""Compiled parts of the fit: what torques do to the angle, and a Kalman filter that whitens the readings.

The shaft is J w' = tau - f_v w with the time constant T = J / f_v. Torques are divided by f_v here, so that they are
the velocities, rad/s, which the shaft would reach.
"""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import kernel

RESIDUAL, ALPHA, BETA, TIME_CONSTANT, KAPPA, ANGLE, SPEED = range(7)
"""Rows of `derivatives`: the residual and its derivatives, the last two to angle and velocity at the beginning."""
SHARED = 5
"""The rows before this one belong to all ramps together."""


@kernel
def respond(time: Array, final: Array, speed: float, T: float) -> tuple[Array, Array]:
    """Return angle, rad, and velocity, rad/s, from an initial velocity, each shape (n,).

    Args:
        time: of the readings, s, shape (n,).
        final: torque over f_v, held from each reading to the next, rad/s, shape (n,).
        speed: velocity at the first reading, rad/s.
        T: time constant, s.
    """
    angles, speeds = np.zeros(time.size), np.full(time.size, speed)
    for k in range(1, time.size):
        step = time[k] - time[k - 1]
        decay = math.exp(-step / T)
        excess = speeds[k - 1] - final[k - 1]
        angles[k] = angles[k - 1] + final[k - 1] * step + excess * T * (1.0 - decay)
        speeds[k] = final[k - 1] + excess * decay
    return angles, speeds


@kernel
def whiten(time: Array, columns: Array, T: float, q: float, r: float) -> tuple[Array, float]:
    """Return columns of angles so that their errors are independent and of variance 1, and the log determinant.

    Errors of the angle are white with the variance r (quantisation), and what white torque noise makes of a shaft whose
    angle and velocity at the first reading are known: an integrated Ornstein-Uhlenbeck process. The innovations of a
    Kalman filter for these, divided by their standard deviations, are the columns times the inverse Cholesky factor of
    the covariance.

    Args:
        time: of the readings, s, shape (n,).
        columns: angles, shape (p, n).
        T: time constant, s.
        q: intensity of the torque noise over f_v, (rad/s)² s.
        r: variance of a reading, rad².
    """
    white = np.empty(columns.shape)
    count = columns.shape[0]
    angle, speed = np.zeros(count), np.zeros(count)
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


@kernel
def derivatives(time: Array, angle: Array, torque: Array, share: Array, shared: Array, start: Array) -> Array:
    """Return the angle's residual and its derivatives (see RESIDUAL), shape (7, n).

    Args:
        time: of the readings, s, shape (n,).
        angle: at the readings, rad, shape (n,).
        torque: commanded, Nm, shape (n,).
        share: what is left of a Stribeck effect, shape (n,).
        shared: alpha, beta, T, kappa.
        start: angle and velocity at the first reading.
    """
    alpha, beta, T, kappa = shared
    final = alpha * torque - beta - kappa * share
    h = 1e-3 * T
    columns = np.empty((7, time.size))
    columns[RESIDUAL] = angle - start[0] - respond(time, final, start[1], T)[0]
    columns[ALPHA] = respond(time, torque, 0.0, T)[0]
    columns[BETA] = respond(time, np.full(time.size, -1.0), 0.0, T)[0]
    columns[TIME_CONSTANT] = (respond(time, final, start[1], T + h)[0] - respond(time, final, start[1], T - h)[0]) / (
        2 * h
    )
    columns[KAPPA] = respond(time, -share, 0.0, T)[0]
    columns[ANGLE] = 1.0
    columns[SPEED] = -T * np.expm1(-(time - time[0]) / T)
    return columns


@kernel
def eliminate(white: Array) -> tuple[Array, Array, float]:
    """Return what is left of whitened columns when angle and velocity at the beginning fit best.

    Returns:
        The gram of the shared rows, shape (5, 5); angle and velocity for each of them, shape (2, 5); the logarithm of
        the determinant of the information on angle and velocity.
    """
    length = math.sqrt(np.sum(white[ANGLE] ** 2))
    first = white[ANGLE] / length
    along = np.sum(white[SPEED] * first)
    second = white[SPEED] - along * first
    height = math.sqrt(np.sum(second**2))
    second = second / height
    free, starts = np.empty((SHARED, white.shape[1])), np.empty((2, SHARED))
    for i in range(SHARED):
        a, b = np.sum(white[i] * first), np.sum(white[i] * second)
        free[i] = white[i] - a * first - b * second
        starts[1, i] = b / height
        starts[0, i] = (a - along * starts[1, i]) / length
    gram = np.empty((SHARED, SHARED))
    for i in range(SHARED):
        for j in range(SHARED):
            gram[i, j] = np.sum(free[i] * free[j])
    return gram, starts, 2.0 * math.log(length * height)
