"""The curves of steady sliding as functions of their parameters, with the derivatives that fits need.

Equation 19 and the viscous part of equation 18: `FrictionElement` evaluates these curves, the fits of the sliding
regime and of the rig differentiate them. The compiled form for simulation is in bristle.py.
"""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array

LINEAR_SPEED = 1e-3
"""The speed, rad/s, below which the viscous part is linear whatever its exponent: motion this slow is presliding."""

_MAX_POWER = 700.0  # of (|v| / omega_s)^delta: beyond it, exp(-x) is no normal number


def stribeck_decay(velocity: Array, omega_s: float, delta: float) -> Array:
    """Return exp(-(|v| / omega_s)^delta), the remaining share of the Stribeck rise; shape of the velocity in rad/s."""
    with np.errstate(over="ignore"):  # nothing is left then
        return np.asarray(np.exp(-((np.abs(velocity) / omega_s) ** delta)))


def stribeck_decay_slopes(velocity: Array, omega_s: float, delta: float) -> tuple[Array, Array, Array]:
    """Return the same, and its derivatives by ln omega_s and by ln delta, each with the shape of the velocity."""
    speed = np.abs(velocity)
    power = np.minimum((speed / omega_s) ** delta, _MAX_POWER)
    decay = np.exp(-power)
    by_omega_s = decay * power * delta
    logarithm = np.log(speed / omega_s, out=np.zeros_like(power), where=speed > 0.0)
    return decay, by_omega_s, -by_omega_s * logarithm


def viscous_torque(velocity: Array, c2: float, alpha: float) -> Array:
    """Return c2 |v|^alpha sign(v), below LINEAR_SPEED the chord of it, Nm, with the shape of the velocity in rad/s.

    The derivative by alpha is this torque times ln max(|v|, LINEAR_SPEED).
    """
    if alpha == 1.0:
        return np.asarray(c2 * velocity)
    return np.asarray(c2 * velocity * np.maximum(np.abs(velocity), LINEAR_SPEED) ** (alpha - 1.0))
