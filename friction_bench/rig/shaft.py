"""The motor's shaft of the emulated rig: exact motion under a torque that is held."""

from __future__ import annotations

import math
from typing import NamedTuple

from rx90_common.kernels.compiled import kernel


class Shaft(NamedTuple):
    """What turns, at the motor: inertia, kg m², Coulomb friction, Nm, and viscous friction, Nm s/rad."""

    inertia: float
    coulomb: float
    viscous: float


BRISTLE_STEPS = 20
"""Substeps of a slice with LuGre friction: 50 µs, a sixtieth of the stiffest joint's period."""


@kernel
def turn(angle: float, speed: float, torque: float, shaft: Shaft, dt: float) -> tuple[float, float]:
    """Advance J w' = torque - f_v w - f_c sgn w over `dt` with a constant torque, exactly.

    Returns angle and speed. A body that comes to rest stays there unless the torque exceeds f_c.
    """
    left = dt
    for _ in range(2):  # at most one reversal: torque is constant
        sign = 1.0 if speed > 0.0 or (speed == 0.0 and torque > 0.0) else -1.0
        if speed == 0.0 and abs(torque) <= shaft.coulomb:
            return angle, 0.0
        final = (torque - sign * shaft.coulomb) / shaft.viscous
        tau = shaft.inertia / shaft.viscous
        run = left
        stops = speed * final < 0.0
        if stops:
            rest = tau * math.log((final - speed) / final)
            stops = rest < left
            run = min(rest, left)
        decay = math.exp(-run / tau)
        angle += final * run + (speed - final) * tau * (1.0 - decay)
        speed = final + (speed - final) * decay
        if not stops:
            return angle, speed
        speed = 0.0
        left -= run
    return angle, speed
