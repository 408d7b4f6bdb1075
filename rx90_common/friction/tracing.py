"""The friction torque of elements with prescribed velocities: only the bristles are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.bristles.step import bristles_dtype, bristles_state_dtype, bristles_step, bristles_torque
from rx90_common.friction.compiled_elements import element_arrays, load_elements, one_element
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load

BRISTLE_STATE_DTYPE = np.dtype([("z", np.float64, (1,)), ("bristles", bristles_state_dtype(1))], align=True)
"""Deflection, rad, of one element, and the further state of its bristles."""


def prescribed_torque(elements: Sequence[FrictionElement], velocity: Array, steps: Array) -> Array:
    """Return the friction torque of each element, the mean over each step, from undeflected bristles on, Nm.

    Args:
        elements: e elements; only their bristles are used, other parts are for the caller to refuse or to report.
        velocity: their input velocities, each held over its step, rad/s, shape (m, e).
        steps: s, shape (m,).

    Returns:
        Shape (m, e).
    """
    torque = np.zeros_like(velocity)
    _bristles(element_arrays(elements), np.ascontiguousarray(velocity), steps, torque)
    for e, element in enumerate(elements):
        if element.bristles is not None:
            torque[:, e] = _other_torque(element, np.ascontiguousarray(velocity[:, e]), steps)
    return torque


def _other_torque(element: FrictionElement, velocity: Array, steps: Array) -> Array:
    """Return the torque of an element with other bristles than LuGre's, shape (m,)."""
    constants, state = np.zeros(1, bristles_dtype(1)), np.zeros(1, BRISTLE_STATE_DTYPE)
    fill_bristles(constants[0], [element.bristles])
    torque, deflection = np.empty_like(velocity), np.empty_like(velocity)
    follow_bristles(element_arrays((element,)), constants, state, velocity, steps, torque, deflection)
    return torque


@kernel
def _bristles(arrays: NDArray[np.void], velocity: Array, steps: Array, torque: Array) -> None:
    """Write the friction torque of each element over each step of prescribed velocities, shape (m, e)."""
    for e in range(torque.shape[1]):
        element, z = one_element(arrays[0], e), 0.0
        for k in range(steps.size):
            z, torque[k, e] = bristle_step(element, z, velocity[k, e], steps[k])


@kernel
def follow_bristles(
    arrays: Any, constants: Any, states: Any, velocity: Array, steps: Array, torque: Array, deflection: Array
) -> None:
    """Write torque and deflection of one element with any bristles in each step of prescribed velocities.

    Args:
        arrays: the element, shape (1,), from `element_arrays`.
        constants: of its bristles, shape (1,), `bristles_dtype(1)`.
        states: at the beginning, shape (1,), BRISTLE_STATE_DTYPE; overwritten.
        velocity: held over each step, rad/s, shape (m,).
        steps: s, shape (m,).
        torque: overwritten with the mean over each step, Nm, shape (m,).
        deflection: overwritten with that at the end of each step, rad, shape (m,).
    """
    element, kinds, state = load_elements(arrays[0], 1), constants[0], states[0].bristles
    z = load(states[0].z, 1)
    still = 0.0 * z
    for k in range(steps.size):
        if steps[k] > 0.0:
            z, mean = bristles_step(element, kinds, state, z, still + velocity[k], steps[k], 1)
        else:  # a mean over no time
            mean = bristles_torque(element, kinds, state, z, still + velocity[k], 1)
        torque[k], deflection[k] = lane(mean, 0), lane(z, 0)
