"""Compiled bristle equations: the exact step of equation 17 for a velocity held over the step."""

from __future__ import annotations

import math
from typing import Any

from rx90_common.compiled import kernel

# Below this product of bristle rate and step, series replace the exponential: they are exact to the last
# bits there, where (1 - exp(-x)) / x would cancel, and a sticking joint costs no exponential at all.
_SMALL = 0.02


@kernel
def sliding_torque(element: Any, velocity: float) -> float:
    """Return c0 g(v), equation 19, Nm; `element` is a record of ELEMENT_DTYPE."""
    sign = 1 if velocity >= 0.0 else 0
    coulomb = element.tau_c[sign]
    ratio = abs(velocity) * element.inverse_omega_s
    if element.delta != 1.0:
        ratio = ratio * ratio if element.delta == 2.0 else ratio**element.delta
    return coulomb + (element.tau_s[sign] - coulomb) * math.exp(-ratio)


@kernel
def damping(element: Any, velocity: float) -> float:
    """Return c1(v), Nm s/rad."""
    ratio = velocity * element.inverse_omega_d
    return element.c1 * math.exp(-ratio * ratio)


@kernel
def friction_torque(element: Any, z: float, velocity: float) -> float:
    """Return the friction torque of equation 18 at one instant, Nm."""
    rate = element.c0 * abs(velocity) / sliding_torque(element, velocity)
    z_dot = velocity - rate * z
    return element.c0 * z + damping(element, velocity) * z_dot + element.c2 * velocity


@kernel
def bristle_step(element: Any, z: float, velocity: float, step: float) -> tuple[float, float]:
    """Advance the bristle deflection by `step` seconds at constant velocity, exactly.

    With x = |v| / g * step, equation 17 has the solution z1 = z + (v step - x z) phi(x),
    phi = (1 - exp(-x)) / x. The bristle's rate |v| / g reaches tens of thousands per second at full joint
    speed, where explicit steps of 250 us diverge; this one holds for every x, and leaves z untouched to the
    last bit at v = 0, so that a sticking joint does not creep.

    Returns:
        The new bristle deflection, rad, and the friction torque (equation 18) averaged over the step, Nm:
        c0 mean(z) + c1 mean(dz/dt) + c2 v, with mean(z) = z + (v step - x z) (1 - phi) / x.
    """
    rate = element.c0 * abs(velocity) / sliding_torque(element, velocity)
    x = rate * step
    if x < _SMALL:
        phi = 1.0 - x * (1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120 - x / 720))))
        psi = 1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120 - x * (1 / 720 - x / 5040))))
    else:
        inverse = 1.0 / x
        phi = (1.0 - math.exp(-x)) * inverse
        psi = (1.0 - phi) * inverse
    z_dot = velocity - rate * z  # at the start of the step; phi times it is the mean
    mean = z + step * z_dot * psi
    torque = element.c0 * mean + damping(element, velocity) * z_dot * phi + element.c2 * velocity
    return z + step * z_dot * phi, torque
