"""A mass on friction under a given force, with bristles of any kind: the plant's step with one degree of freedom."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import one_element
from rx90_common.friction.bristles.elasto_plastic import ElastoPlastic
from rx90_common.friction.bristles.maxwell_slip import MaxwellSlip
from rx90_common.friction.bristles.record import bristles_dtype, bristles_state_dtype, fill_bristles, kind_step
from rx90_common.friction.element import element_arrays
from rx90_common.kernels.compiled import kernel

Array = NDArray[np.float64]
Bristles = ElastoPlastic | MaxwellSlip | None


class Motion(NamedTuple):
    """Of a mass, after each step: rad, rad/s, mean friction torque of the step, Nm, deflection, rad."""

    position: Array
    velocity: Array
    friction: Array
    deflection: Array


def _records(element: FrictionElement, bristles: Bristles) -> tuple[Any, Any, Any]:
    constants, state = np.zeros(1, bristles_dtype(1)), np.zeros(1, bristles_state_dtype(1))
    fill_bristles(constants[0], [bristles])
    return element_arrays((element,)), constants, state


def driven_mass(
    element: FrictionElement, bristles: Bristles, inertia: float, force: Array, step: float, start: float = 0.0
) -> Motion:
    """Return the motion of a mass under forces that are each held over a step, from position 0.

    Args:
        element: its friction.
        bristles: of what kind; None is LuGre's.
        inertia: kg m^2.
        force: in the middle of each step, Nm, shape (m,).
        step: s.
        start: velocity at the beginning, rad/s.
    """
    motion = Motion(*np.empty((4, force.size)))
    _drive(*_records(element, bristles), inertia, force, step, start, motion)
    return motion


def led(element: FrictionElement, bristles: Bristles, velocity: Array, step: float) -> tuple[Array, Array]:
    """Return the mean friction torque over each step of a given motion, Nm, and the energy stored after it, J.

    Args:
        element: the friction.
        bristles: of what kind; None is LuGre's.
        velocity: held over each step, rad/s, shape (m,).
        step: s.
    """
    torque, stored = np.empty((2, velocity.size))
    _lead(*_records(element, bristles), velocity, step, torque, stored)
    return torque, stored


@kernel
def _drive(
    elements: Any, constants: Any, states: Any, inertia: float, force: Array, step: float, start: float, motion: Motion
) -> None:
    element, blocks = one_element(elements[0], 0), states[0].blocks[0]
    x, v, z, a = 0.0, start, 0.0, 0.0
    for k in range(force.size):
        # As in the plant: the last step's acceleration and the jump of the force predict the middle of the step.
        a += (force[k] - force[max(0, k - 1)]) / inertia
        z, friction = kind_step(element, constants[0], 0, blocks, z, v + 0.5 * step * a, step)
        a = (force[k] - friction) / inertia
        x += step * (v + 0.5 * step * a)
        v += step * a
        motion.position[k], motion.velocity[k], motion.friction[k], motion.deflection[k] = x, v, friction, z


@kernel
def _lead(
    elements: Any, constants: Any, states: Any, velocity: Array, step: float, torque: Array, stored: Array
) -> None:
    element, blocks, record = one_element(elements[0], 0), states[0].blocks[0], constants[0]
    z = 0.0
    for k in range(velocity.size):
        z, torque[k] = kind_step(element, record, 0, blocks, z, velocity[k], step)
        square = z * z
        if record.kind[0] == 2:
            square = 0.0
            for i in range(blocks.shape[1]):
                square += record.blocks.stiffness[0, i] * blocks[0, i] * blocks[0, i]
        stored[k] = 0.5 * element.c0 * square
