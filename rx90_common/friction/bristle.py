"""Compiled bristle equations: the exact step of equation 17 for a constant velocity.

Velocity, deflection and the fields of `element`, an `Elements` of rx90_common.friction.compiled_elements, are plain
numbers, or lanes with one friction element each: the equations are the same.
"""

from __future__ import annotations

from typing import Any

from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential, power
from rx90_common.kernels.lanes import Number, absolute, any_lane, fma, select

# Below this product of bristle rate and step, series replace the exponential: they are exact to the last
# bits there, where (1 - exp(-x)) / x would cancel.
_SMALL = 0.02


@kernel
def sliding_torque(element: Any, velocity: Number) -> Number:
    """Return c0 g(v), equation 19, Nm."""
    forward = velocity >= 0.0
    coulomb = select(forward, element.tau_c[0], element.tau_c[1])
    static = select(forward, element.tau_s[0], element.tau_s[1])
    ratio = power(absolute(velocity) * element.inverse_omega_s, element.delta)
    return fma(static - coulomb, exponential(-ratio), coulomb)


@kernel
def damping(element: Any, velocity: Number) -> Number:
    """Return c1(v), Nm s/rad."""
    ratio = velocity * element.inverse_omega_d
    return element.c1 * exponential(-(ratio * ratio))


@inlined
def viscous_torque(element: Any, velocity: Number) -> Number:
    """Return c2 |v|^alpha sign(v), Nm; below LINEAR_SPEED the chord of it. With alpha = 1 it has the bits of c2 v.

    With alpha < 1 the power has an infinite slope at rest. A velocity that is held for a step would change its sign
    from step to step there, and a sticking joint would creep; the chord lets it come to rest to the last bit.
    """
    shaped = velocity
    other = absolute(element.alpha - 1.0) > 0.0
    if any_lane(other):
        speed = absolute(velocity)
        base = select(speed < LINEAR_SPEED, LINEAR_SPEED, speed)
        shaped = select(other, velocity / base * power(base, element.alpha), velocity)
    return element.c2 * shaped


@kernel
def friction_torque(element: Any, z: Number, velocity: Number) -> Number:
    """Return the friction torque of equation 18 at one instant, Nm."""
    rate = element.c0 * absolute(velocity) / sliding_torque(element, velocity)
    z_dot = velocity - rate * z
    return element.c0 * z + damping(element, velocity) * z_dot + viscous_torque(element, velocity)


@kernel
def bristle_step(element: Any, z: Number, velocity: Number, step: float) -> tuple[Number, Number]:
    """Advance the bristle deflection by `step` seconds at constant velocity, exactly.

    With x = |v| / g * step, equation 17 has the solution z1 = z + (v step - x z) phi(x),
    phi = (1 - exp(-x)) / x. The bristle's rate |v| / g reaches tens of thousands per second at full joint
    speed, where explicit steps of 250 us diverge; this one holds for every x, and leaves z untouched to the
    last bit at v = 0, so that a sticking joint does not creep.

    Returns:
        The new bristle deflection, rad, and the friction torque (equation 18) averaged over the step, Nm:
        c0 mean(z) + c1 mean(dz/dt) + viscous torque, with mean(z) = z + (v step - x z) (1 - phi) / x.
    """
    rate = element.c0 * absolute(velocity) / sliding_torque(element, velocity)
    phi, psi = decay(rate * step)
    z_dot = velocity - rate * z  # at the start of the step; phi times it is the mean
    mean = z + step * z_dot * psi
    torque = (
        element.c0 * mean
        + damping(element, velocity) * z_dot * phi
        + viscous_torque(element, velocity)
    )
    return z + step * z_dot * phi, torque


@inlined
def decay(x: Number) -> tuple[Number, Number]:
    """Return phi = (1 - exp(-x)) / x and psi = (1 - phi) / x for x >= 0."""
    inverse = 1.0 / x
    phi = (1.0 - exponential(-x)) * inverse
    psi = (1.0 - phi) * inverse
    # 1/2 - x/6 + x^2/24 - ...
    series = fma(
        x, fma(x, fma(x, fma(x, fma(x, -1 / 5040, 1 / 720), -1 / 120), 1 / 24), -1 / 6), 1 / 2
    )
    small = x < _SMALL
    return select(small, fma(-x, series, 1.0), phi), select(small, series, psi)
