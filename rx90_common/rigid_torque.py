"""The torque of an arm without friction along a motion, by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array


def rigid_torque(
    model: Any, rotor: Array, spring: Array, position: Array, velocity: Array, acceleration: Array
) -> Array:
    """Return M(q) a + h(q, v) along a motion: the drives' torques at the joints in the absence of friction.

    Args:
        model: Pinocchio's model of n turning joints, from base to tip.
        rotor: share of the rotors in the mass matrix, couplings included, kg m^2, shape (n, n).
        spring: amplitudes k of springs with the torque -k sin(q) on the joints, Nm, shape (n,).
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        acceleration: rad/s^2, shape (m, n).

    Returns:
        Inertial, Coriolis, centrifugal and gravity torques (recursive Newton-Euler: Featherstone 2008, table 5.1), and
        those of rotors and springs, Nm, shape (m, n).
    """
    data = model.createData()
    rows = zip(configurations(model, position), velocity, acceleration, strict=True)
    links = np.array([pin.rnea(model, data, *row) for row in rows]).reshape(position.shape)
    return links + (acceleration @ rotor.T + spring * np.sin(position))


def configurations(model: Any, position: Array) -> Array:
    """Return Pinocchio's configurations, shape (m, nq): joints without limits have a sine and a cosine in it."""
    if model.nq == model.nv:
        return position
    neutral = pin.neutral(model)
    return np.array([pin.integrate(model, neutral, row) for row in position])
