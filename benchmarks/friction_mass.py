"""A mass on friction under a given force, with bristles of any kind: the plant's step with one degree of freedom."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction import FrictionElement
from rx90_common.friction.bristles.step import bristles_dtype, bristles_step
from rx90_common.friction.compiled_elements import element_arrays, load_elements
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.friction.tracing import BRISTLE_STATE_DTYPE
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Of a mass, after each step: rad, rad/s, mean friction torque of the step, Nm, deflection, rad."""

    position: Array
    velocity: Array
    friction: Array
    deflection: Array


def _records(element: FrictionElement) -> tuple[Any, Any, Any]:
    constants = np.zeros(1, bristles_dtype(1))
    state = np.zeros(1, BRISTLE_STATE_DTYPE)
    fill_bristles(constants[0], [element.bristles])
    return element_arrays((element,)), constants, state


def driven_mass(element: FrictionElement, inertia: float, force: Array, step: float, start: float = 0.0) -> Motion:
    """Return the motion of a mass under forces that are each held over a step, from position 0.

    Args:
        element: its friction.
        inertia: kg m^2.
        force: in the middle of each step, Nm, shape (m,).
        step: s.
        start: velocity at the beginning, rad/s.
    """
    motion = Motion(*np.empty((4, force.size)))
    _drive(*_records(element), inertia, force, step, start, motion)
    return motion


def led(element: FrictionElement, velocity: Array, step: float) -> tuple[Array, Array]:
    """Return the mean friction torque over each step of a given motion, Nm, and the energy stored after it, J.

    Args:
        element: the friction.
        velocity: held over each step, rad/s, shape (m,).
        step: s.
    """
    torque, stored = np.empty((2, velocity.size))
    _lead(*_records(element), velocity, step, torque, stored)
    return torque, stored


@kernel
def _drive(
    elements: Any, constants: Any, states: Any, inertia: float, force: Array, step: float, start: float, motion: Motion
) -> None:
    element, kinds, state = load_elements(elements[0], 1), constants[0], states[0].bristles
    x, v, a = 0.0, start, 0.0
    nothing = load(states[0].z, 1)
    z = nothing
    for k in range(force.size):
        # As in the plant: the last step's acceleration and the jump of the force predict the middle of the step.
        a += (force[k] - force[max(0, k - 1)]) / inertia
        middle = nothing + (v + 0.5 * step * a)
        z, friction = bristles_step(element, kinds, state, z, middle, step, 1)
        a = (force[k] - lane(friction, 0)) / inertia
        x += step * (v + 0.5 * step * a)
        v += step * a
        motion.position[k], motion.velocity[k] = x, v
        motion.friction[k], motion.deflection[k] = lane(friction, 0), lane(z, 0)


@kernel
def _lead(
    elements: Any, constants: Any, states: Any, velocity: Array, step: float, torque: Array, stored: Array
) -> None:
    element, kinds, state = load_elements(elements[0], 1), constants[0], states[0].bristles
    nothing = load(states[0].z, 1)
    z = nothing
    for k in range(velocity.size):
        z, mean = bristles_step(element, kinds, state, z, nothing + velocity[k], step, 1)
        torque[k] = lane(mean, 0)
        square = lane(z, 0) ** 2
        if kinds.blocks_used:
            square = 0.0
            for i in range(state.blocks.shape[2]):
                square += kinds.blocks.stiffness[0, i] * state.blocks[0, 0, i] ** 2
        stored[k] = 0.5 * elements[0].c0[0] * square
