"""Compiled bristle equations: the exact step of equation 17 for a velocity held over the step.

`element` is a record of ELEMENT_DTYPE with plain floats, or `Elements` with one lane per friction element and
lanes for velocity and deflection: the equations are the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rx90_common.friction.lugre import ELEMENT_DTYPE
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential, power
from rx90_common.kernels.lanes import Lanes, Number, absolute, fma, load, select


def elements_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of a record of `width` elements, field by field: the element is the last index."""
    names = ELEMENT_DTYPE.names or ()
    return np.dtype(
        [(name, ELEMENT_DTYPE[name].base, (*ELEMENT_DTYPE[name].shape, width)) for name in names], align=True
    )


# Below this product of bristle rate and step, series replace the exponential: they are exact to the last
# bits there, where (1 - exp(-x)) / x would cancel.
_SMALL = 0.02


class Elements(NamedTuple):
    """The fields of ELEMENT_DTYPE, one lane per element."""

    tau_c: tuple[Lanes, Lanes]
    tau_s: tuple[Lanes, Lanes]
    inverse_omega_s: Lanes
    delta: Lanes
    c0: Lanes
    c1: Lanes
    c2: Lanes
    inverse_omega_d: Lanes


@inlined
def load_elements(records: Any, width: int) -> Elements:
    """Return the elements of a record of `elements_dtype(width)`; `width` is a literal."""
    return Elements(
        (load(records.tau_c[0], width), load(records.tau_c[1], width)),
        (load(records.tau_s[0], width), load(records.tau_s[1], width)),
        load(records.inverse_omega_s, width),
        load(records.delta, width),
        load(records.c0, width),
        load(records.c1, width),
        load(records.c2, width),
        load(records.inverse_omega_d, width),
    )


@kernel
def sliding_torque(element: Any, velocity: Number) -> Number:
    """Return c0 g(v), equation 19, Nm."""
    forward = velocity >= 0.0
    coulomb = select(forward, element.tau_c[1], element.tau_c[0])
    static = select(forward, element.tau_s[1], element.tau_s[0])
    ratio = power(absolute(velocity) * element.inverse_omega_s, element.delta)
    return fma(static - coulomb, exponential(-ratio), coulomb)


@kernel
def damping(element: Any, velocity: Number) -> Number:
    """Return c1(v), Nm s/rad."""
    ratio = velocity * element.inverse_omega_d
    return element.c1 * exponential(-(ratio * ratio))


@kernel
def friction_torque(element: Any, z: Number, velocity: Number) -> Number:
    """Return the friction torque of equation 18 at one instant, Nm."""
    rate = element.c0 * absolute(velocity) / sliding_torque(element, velocity)
    z_dot = velocity - rate * z
    return element.c0 * z + damping(element, velocity) * z_dot + element.c2 * velocity


@kernel
def bristle_step(element: Any, z: Number, velocity: Number, step: float) -> tuple[Number, Number]:
    """Advance the bristle deflection by `step` seconds at constant velocity, exactly.

    With x = |v| / g * step, equation 17 has the solution z1 = z + (v step - x z) phi(x),
    phi = (1 - exp(-x)) / x. The bristle's rate |v| / g reaches tens of thousands per second at full joint
    speed, where explicit steps of 250 us diverge; this one holds for every x, and leaves z untouched to the
    last bit at v = 0, so that a sticking joint does not creep.

    Returns:
        The new bristle deflection, rad, and the friction torque (equation 18) averaged over the step, Nm:
        c0 mean(z) + c1 mean(dz/dt) + c2 v, with mean(z) = z + (v step - x z) (1 - phi) / x.
    """
    rate = element.c0 * absolute(velocity) / sliding_torque(element, velocity)
    phi, psi = decay(rate * step)
    z_dot = velocity - rate * z  # at the start of the step; phi times it is the mean
    mean = z + step * z_dot * psi
    torque = element.c0 * mean + damping(element, velocity) * z_dot * phi + element.c2 * velocity
    return z + step * z_dot * phi, torque


@inlined
def decay(x: Number) -> tuple[Number, Number]:
    """Return phi = (1 - exp(-x)) / x and psi = (1 - phi) / x for x >= 0."""
    inverse = 1.0 / x
    phi = (1.0 - exponential(-x)) * inverse
    psi = (1.0 - phi) * inverse
    # 1/2 - x/6 + x^2/24 - ...
    series = fma(x, fma(x, fma(x, fma(x, fma(x, -1 / 5040, 1 / 720), -1 / 120), 1 / 24), -1 / 6), 1 / 2)
    small = x < _SMALL
    return select(small, fma(-x, series, 1.0), phi), select(small, series, psi)
