"""A bristle deflected along a given motion: what does not depend on c0 and c1 is computed once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import damping, decay, one_element, sliding_torque
from rx90_common.friction.element import element_arrays
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.presliding.band import block_means


@dataclass(frozen=True, eq=False)
class BristlePath:
    """A motion of one element, as its bristle sees it.

    Attributes:
        motion: input velocity, held over each step, rad/s; c0 g(v), equation 19, Nm; c1(v) / c1; shape (3, m).
        viscous: viscous torque, Nm, block means, shape (m // BLOCK,).
        coulomb: Coulomb torque, Nm.
        step: s.
    """

    motion: Array
    viscous: Array
    coulomb: float
    step: float

    @classmethod
    def of(cls, element: FrictionElement, speed: Array, step: float) -> BristlePath:
        """Return the path of an element, of which c0 and c1 are not used.

        Args:
            element: its sliding regime.
            speed: input velocity, rad/s, shape (m,).
            step: s.
        """
        motion = np.empty((3, len(speed)))
        motion[0] = speed
        _sliding_regime(element_arrays((replace(element, c1=1.0),)), motion)
        return cls(motion, block_means(element.viscous_torque(speed)), element.tau_c_positive, step)

    @property
    def speed(self) -> Array:
        """Return the input velocity, rad/s, shape (m,)."""
        return np.asarray(self.motion[0])

    def deflect(self, c0: float, start: float) -> tuple[Array, Array]:
        """Return block means of the bristle's torque, Nm, and of the rate that c1 multiplies, rad/s.

        Args:
            c0: Nm/rad.
            start: deflection at the start over that of steady sliding.
        """
        result = np.empty((2, self.motion.shape[1]))
        deflect_bristle(self.motion, self.step, c0, start * self.coulomb / c0, result)
        return block_means(result[0]), block_means(result[1])


@kernel
def _sliding_regime(arrays: NDArray[Any], motion: Array) -> None:
    element = one_element(arrays[0], 0)
    for row in range(motion.shape[1]):
        motion[1, row] = sliding_torque(element, motion[0, row])
        motion[2, row] = damping(element, motion[0, row])


@kernel
def deflect_bristle(motion: Array, step: float, c0: float, start: float, result: Array) -> None:
    """Deflect a bristle by the exact steps of the simulation.

    Args:
        motion: as the attribute of BristlePath, shape (3, m).
        step: s.
        c0: Nm/rad.
        start: deflection at the start, rad.
        result: takes the means over each step of the bristle's torque, Nm, and of the rate of deflection times
            c1(v) / c1, rad/s, shape (2, m).
    """
    z = start
    for row in range(motion.shape[1]):
        v = motion[0, row]
        rate = c0 * abs(v) / motion[1, row]
        phi, psi = decay(rate * step)
        z_dot = v - rate * z
        result[0, row] = c0 * (z + step * z_dot * psi)
        result[1, row] = motion[2, row] * z_dot * phi
        z += step * z_dot * phi
