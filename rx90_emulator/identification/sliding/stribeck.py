"""The torque of an element that slides steadily, as the fit writes it, with its derivatives.

With dz/dt = 0, equations 17 to 19 leave sign(v) [tau_c + d exp(-(|v| / omega_s)^delta) + c2 |v|^alpha] with the
Stribeck rise d = tau_s - tau_c. Written in d and in the logarithms of omega_s, delta and alpha, the bounds
tau_s >= tau_c > 0 and omega_s, delta > 0 are plain, and five of the eight parameters are linear.
"""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction.curves import LINEAR_SPEED, stribeck_decay_slopes, viscous_torque
from rx90_emulator.identification.model.estimates import SLIDING, VISCOUS_EXPONENT

SIZE = 8
"""Parameters of an element in the fit: tau_c+, tau_c-, d+, d-, c2, ln omega_s, ln delta, ln alpha."""
LINEAR = slice(0, 5)
RISE = slice(2, 4)
VISCOUS = 4
SHAPE = slice(5, 7)
EXPONENT = 7


def basis(velocity: Array, parameters: Array) -> Array:
    """Return the derivatives by the five linear parameters, shape (m, 5); those of `parameters` do not count."""
    return _basis(velocity, parameters, _decay_slopes(velocity, parameters)[0])


def torque(velocity: Array, parameters: Array) -> Array:
    """Return the friction torque, Nm, shape (m,)."""
    return np.asarray(basis(velocity, parameters) @ parameters[LINEAR])


def torque_jacobian(velocity: Array, parameters: Array) -> Array:
    """Return the derivatives of the torque by all parameters, shape (m, 8)."""
    decay, by_omega_s, by_delta = _decay_slopes(velocity, parameters)
    rise = np.where(velocity > 0.0, parameters[2], np.where(velocity < 0.0, -parameters[3], 0.0))
    linear = _basis(velocity, parameters, decay)
    logarithm = np.log(np.maximum(np.abs(velocity), LINEAR_SPEED))
    by_alpha = np.exp(parameters[EXPONENT]) * parameters[VISCOUS] * linear[:, VISCOUS] * logarithm
    return np.column_stack([linear, rise * by_omega_s, rise * by_delta, by_alpha])


def _decay_slopes(velocity: Array, parameters: Array) -> tuple[Array, Array, Array]:
    omega_s, delta = np.exp(parameters[SHAPE]).tolist()
    return stribeck_decay_slopes(velocity, omega_s, delta)


def _basis(velocity: Array, parameters: Array, decay: Array) -> Array:
    forward, backward = velocity > 0.0, velocity < 0.0
    viscous = viscous_torque(velocity, 1.0, float(np.exp(parameters[EXPONENT])))
    return np.column_stack([1.0 * forward, -1.0 * backward, decay * forward, -decay * backward, viscous])


def natural(parameters: Array) -> dict[str, float]:
    """Return the parameters by the names in SLIDING, and the viscous exponent by its own."""
    coulomb_up, coulomb_down, rise_up, rise_down, viscous = (float(value) for value in parameters[LINEAR])
    omega_s, delta = (float(value) for value in np.exp(parameters[SHAPE]))
    values = (coulomb_up, coulomb_down, coulomb_up + rise_up, coulomb_down + rise_down, omega_s, delta, viscous)
    return dict(zip(SLIDING, values, strict=True)) | {VISCOUS_EXPONENT: float(np.exp(parameters[EXPONENT]))}


def natural_jacobian(parameters: Array) -> Array:
    """Return the derivatives of what `natural` returns by the parameters of the fit, shape (8, 8)."""
    matrix = np.zeros((SIZE, SIZE))
    matrix[0, 0] = matrix[1, 1] = matrix[2, 0] = matrix[2, 2] = matrix[3, 1] = matrix[3, 3] = 1.0
    matrix[4, 5], matrix[5, 6] = np.exp(parameters[SHAPE])
    matrix[6, VISCOUS] = 1.0
    matrix[7, EXPONENT] = np.exp(parameters[EXPONENT])
    return matrix
