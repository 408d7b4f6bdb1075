"""The bristles of several elements in compiled code, each of its own kind: constants, state, steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.bristles.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.bristles.maxwell_slip import (
    MAX_BLOCKS,
    blocks_dtype,
    maxwell_slip_step,
    maxwell_slip_torque,
    weighted_squares,
)
from rx90_common.friction.compiled_elements import lane_of
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, lane, load, select, store


def bristles_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the constants of `width` elements' bristles."""
    return np.dtype(
        [
            ("elastic_used", np.int64),  # 1 if any element is elasto-plastic
            ("blocks_used", np.int64),  # 1 if any element has blocks
            ("elastic", np.float64, (width,)),  # 1 where it is elasto-plastic
            ("blocked", np.int64, (width,)),  # 1 where it has blocks
            ("break_away", np.float64, (width,)),
            ("blocks", blocks_dtype(width)),
        ],
        align=True,
    )


def bristles_state_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the bristles' state besides the deflection that every element has."""
    return np.dtype(
        [
            ("blocks", np.float64, (width, 2, MAX_BLOCKS)),  # deflections and senses, as `maxwell_slip_step` has them
            ("deflection", np.float64, (width,)),  # workspace of a step
            ("torque", np.float64, (width,)),
        ],
        align=True,
    )


@inlined
def reset_bristles(state: Any) -> None:
    """Put all blocks at rest; the elements' deflections are the caller's."""
    state.blocks[:] = 0.0


@inlined
def bristles_step(
    element: Any, kinds: Any, state: Any, z: Lanes, velocity: Lanes, step: float, width: int
) -> tuple[Lanes, Lanes]:
    """Advance the bristles of all elements by `step` seconds at constant velocity.

    Args:
        element: a lane for each of the elements, as they are in this step.
        kinds: record of `bristles_dtype(width)`.
        state: record of `bristles_state_dtype(width)`, advanced in place.
        z: deflections, rad; of blocks their mean by stiffness.
        velocity: rad/s.
        step: s.
        width: elements, a literal.

    Returns:
        The new deflections, rad, and the friction torques averaged over the step, Nm.
    """
    new, torque = bristle_step(element, z, velocity, step)
    if kinds.elastic_used:
        elastic = load(kinds.elastic, width) > 0.0
        # An element of another kind has no motion here: nothing is computed for its way to sliding.
        moving = select(elastic, velocity, 0.0)
        elasto_plastic, its_torque = elasto_plastic_step(element, load(kinds.break_away, width), z, moving, step)
        new, torque = select(elastic, elasto_plastic, new), select(elastic, its_torque, torque)
    if kinds.blocks_used:
        store(state.deflection, new)
        store(state.torque, torque)
        for e in range(width):
            if kinds.blocked[e]:
                state.deflection[e], state.torque[e] = maxwell_slip_step(
                    lane_of(element, e), kinds.blocks, e, state.blocks[e], lane(velocity, e), step
                )
        new, torque = load(state.deflection, width), load(state.torque, width)
    return new, torque


@inlined
def bristles_torque(element: Any, kinds: Any, state: Any, z: Lanes, velocity: Lanes, width: int) -> Lanes:
    """Return the friction torques of all elements at one instant, Nm; arguments as those of `bristles_step`."""
    torque = friction_torque(element, z, velocity)
    if kinds.elastic_used:
        elasto_plastic = elasto_plastic_torque(element, load(kinds.break_away, width), z, velocity)
        torque = select(load(kinds.elastic, width) > 0.0, elasto_plastic, torque)
    if kinds.blocks_used:
        store(state.torque, torque)
        for e in range(width):
            if kinds.blocked[e]:
                state.torque[e] = maxwell_slip_torque(
                    lane_of(element, e), kinds.blocks, e, state.blocks[e], lane(velocity, e)
                )
        torque = load(state.torque, width)
    return torque


@inlined
def bristles_energy(c0: Lanes, kinds: Any, state: Any, z: Lanes, width: int) -> Lanes:
    """Return the stored energy of all elements' bristles, J, for their stiffnesses c0, Nm/rad, and deflections, rad."""
    energy = 0.5 * c0 * z * z
    if kinds.blocks_used:
        store(state.torque, energy)
        for e in range(width):
            if kinds.blocked[e]:
                state.torque[e] = 0.5 * lane(c0, e) * weighted_squares(kinds.blocks, e, state.blocks[e])
        energy = load(state.torque, width)
    return energy
