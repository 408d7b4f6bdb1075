"""Compiled deflection of bristles along one motion, several of different parameters at a time."""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential
from rx90_common.kernels.lanes import Number, absolute, fma, load, select, store
from rx90_emulator.identification.excitation.friction.law import LARGEST_POWER, ElementShape


def bristle_parameters(shape: ElementShape) -> tuple[float, float, float, float]:
    """Return rise, ln omega_s, delta and stiffness in 1/rad, as `deflect_bristles` takes them."""
    return shape.rise, math.log(shape.omega_s), shape.delta, shape.stiffness


@inlined
def _product(speed: Number, logarithm: Number, rise: float, begin: float, delta: float, reach: float) -> Number:
    """Return the bristle's rate |v| / g times the step, of which `reach` is the part without |v| and h."""
    product = reach * absolute(speed)
    if rise == 0.0:
        return product
    power = delta * (logarithm - begin)
    faded = select(power < LARGEST_POWER, power, LARGEST_POWER)
    return product / (1.0 + rise * exponential(-exponential(faded)))


@kernel
def deflect_bristles(speed: Array, logarithm: Array, parameters: Array, step: float, result: Array) -> None:
    """Deflect bristles from rest, by steps that are exact for a velocity that is held.

    What depends on the velocity alone is computed for eight steps side by side; only the deflection goes from one step
    to the next.

    Args:
        speed: held over each step, rad/s, shape (m,).
        logarithm: of its size, shape (m,).
        parameters: rise, ln omega_s, delta and stiffness of each bristle, shape (b, 4).
        step: s.
        result: takes u = c0 z / tau_c and dz/dt, rad/s, means over the two steps around each sample, shape (b, 2, m).
    """
    count = len(speed)
    whole = count - count % 8
    products, phis, psis = np.empty(count), np.empty(count), np.empty(count)
    for number in range(len(parameters)):
        rise, begin, delta, stiffness = parameters[number]
        reach = stiffness * step
        for row in range(0, whole, 8):
            several = _product(load(speed[row:], 8), load(logarithm[row:], 8), rise, begin, delta, reach)
            both = decay(several)
            store(products[row:], several)
            store(phis[row:], both[0])
            store(psis[row:], both[1])
        for row in range(whole, count):
            products[row] = _product(speed[row], logarithm[row], rise, begin, delta, reach)
            phis[row], psis[row] = decay(products[row])
        torque, rate = result[number, 0], result[number, 1]
        u = 0.0
        for row in range(count):
            # u_1 = u + (stiffness v step - x u) phi, written so that few operations wait for u.
            push, phi = reach * speed[row], phis[row]
            started = push - products[row] * u
            torque[row] = u + started * psis[row]
            rate[row] = started * phi
            u = fma(1.0 - products[row] * phi, u, push * phi)
        for row in range(count - 1):
            torque[row] = 0.5 * (torque[row] + torque[row + 1])
            rate[row] = 0.5 * (rate[row] + rate[row + 1])
        for row in range(count):
            rate[row] /= reach
