"""The friction torque of elements whose velocity is prescribed: the bristles follow, nothing else does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import bristle_step, one_element
from rx90_common.friction.element import FrictionElement, element_arrays
from rx90_common.kernels.compiled import kernel


def prescribed_torque(elements: Sequence[FrictionElement], velocity: Array, steps: Array) -> Array:
    """Return the friction torque of each element, the mean over each step, from undeflected bristles on, Nm.

    Args:
        elements: e elements; of their parts nothing is seen, which is for the caller to refuse or to say.
        velocity: their input velocities, each held over its step, rad/s, shape (m, e).
        steps: s, shape (m,).

    Returns:
        Shape (m, e).
    """
    torque = np.zeros_like(velocity)
    _bristles(element_arrays(elements), np.ascontiguousarray(velocity), steps, torque)
    return torque


@kernel
def _bristles(arrays: NDArray[np.void], velocity: Array, steps: Array, torque: Array) -> None:
    """Write the friction torque of each element over each step of prescribed velocities, shape (m, e)."""
    for e in range(torque.shape[1]):
        element, z = one_element(arrays[0], e), 0.0
        for k in range(steps.size):
            z, torque[k, e] = bristle_step(element, z, velocity[k, e], steps[k])
