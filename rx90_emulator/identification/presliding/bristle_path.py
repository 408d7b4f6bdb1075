"""One friction element bent along a given motion: what does not change from guess to guess is computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction import LuGreElement
from rx90_common.friction.bristle import damping, decay, one_element, sliding_torque
from rx90_common.friction.lugre import element_arrays
from rx90_common.kernels.compiled import kernel

Array = NDArray[np.float64]

THIN = 8
"""Steps of the simulation in one compared torque."""


@dataclass(frozen=True, eq=False)
class BristlePath:
    """A motion of one element, as its bristle sees it.

    Attributes:
        speed: input velocity, held over each step, rad/s, shape (m,).
        strength: c0 g(v), equation 19, Nm, shape (m,).
        fade: c1(v) / c1, shape (m,).
        viscous: c2 v, Nm, thinned.
        coulomb: Coulomb torque, Nm.
        step: s.
    """

    speed: Array
    strength: Array
    fade: Array
    viscous: Array
    coulomb: float
    step: float

    def bent(self, c0: float, start: float) -> tuple[Array, Array]:
        """Return the bristle's torque, Nm, and the rate that c1 multiplies, rad/s, means of steps, thinned.

        Args:
            c0: Nm/rad.
            start: deflection at the start, in parts of that of sliding.
        """
        torque, rate = np.empty_like(self.speed), np.empty_like(self.speed)
        bend(self.speed, self.strength, self.fade, self.step, c0, start * self.coulomb / c0, torque, rate)
        return thinned(torque), thinned(rate)


def thinned(values: Array) -> Array:
    """Return means of THIN rows; white noise stays white, and micro-oscillations are slower."""
    length = len(values) // THIN * THIN
    return np.asarray(values[:length].reshape(-1, THIN, *values.shape[1:]).mean(axis=1))


def slide(element: LuGreElement, speed: Array, step: float) -> BristlePath:
    """Return the path of an element, of which c0 and c1 are not looked at."""
    strength, fade = np.empty(len(speed)), np.empty(len(speed))
    _sliding_regime(element_arrays((replace(element, c1=1.0),)), speed, strength, fade)
    return BristlePath(
        np.ascontiguousarray(speed), strength, fade, thinned(element.c2 * speed), element.tau_c_positive, step
    )


@kernel
def _sliding_regime(arrays: NDArray[Any], speed: Array, strength: Array, fade: Array) -> None:
    element = one_element(arrays[0], 0)
    for row in range(speed.size):
        strength[row] = sliding_torque(element, speed[row])
        fade[row] = damping(element, speed[row])


@kernel
def bend(
    speed: Array, strength: Array, fade: Array, step: float, c0: float, start: float, torque: Array, damped: Array
) -> None:
    """Bend a bristle by the exact steps of the simulation.

    Args:
        speed: as the attribute of BristlePath.
        strength: the same.
        fade: the same.
        step: s.
        c0: Nm/rad.
        start: deflection at the start, rad.
        torque: takes the bristle's mean torque over each step, Nm, shape (m,).
        damped: takes the mean rate of deflection, faded as c1 is, rad/s, shape (m,).
    """
    z = start
    for row in range(speed.size):
        v = speed[row]
        rate = c0 * abs(v) / strength[row]
        phi, psi = decay(rate * step)
        z_dot = v - rate * z
        torque[row] = c0 * (z + step * z_dot * psi)
        damped[row] = fade[row] * z_dot * phi
        z += step * z_dot * phi
