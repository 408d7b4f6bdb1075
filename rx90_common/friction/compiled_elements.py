"""Friction elements in compiled code: records and tuples of their parameters, steps of their bristles of all kinds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Record, RecordType, record_type
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.maxwell_slip import (
    maxwell_slip_step,
    maxwell_slip_torque,
    weighted_squares,
)
from rx90_common.friction.parts.bristles import bristles_dtype, bristles_state_dtype, fill_bristles
from rx90_common.friction.signs import SIGNS
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, lane, load, select, store


class Elements(NamedTuple):
    """One or more elements: numbers of one, or lanes of several; torques as (positive, negative)."""

    tau_c: tuple[Any, Any]
    tau_s: tuple[Any, Any]
    inverse_omega_s: Any
    delta: Any
    c0: Any
    c1: Any
    c2: Any
    inverse_omega_d: Any
    alpha: Any


def elements_dtype(width: int) -> RecordType:
    """Return the type of `width` elements as compiled code reads them: a struct of arrays, the element the last index.

    The fields are those of `Elements`. The torques have a row for each of SIGNS; v = 0 counts as positive.
    """
    shapes: dict[str, Any] = dict.fromkeys(Elements._fields, width)
    shapes["tau_c"] = shapes["tau_s"] = (len(SIGNS), width)
    return record_type(**shapes)


def element_arrays(elements: Sequence[FrictionElement]) -> Record:
    """Return elements as compiled code reads them, shape (1,), dtype `elements_dtype(len(elements))`."""
    arrays = np.zeros(1, elements_dtype(len(elements)))
    record = arrays[0]
    for e, element in enumerate(elements):
        record["tau_c"][:, e] = element.tau_c.both
        record["tau_s"][:, e] = element.tau_s.both
        record["inverse_omega_s"][e] = 1.0 / element.omega_s
        record["inverse_omega_d"][e] = 1.0 / element.omega_d
        values = element.parameters
        for name in ("delta", "c0", "c1", "c2", "alpha"):
            record[name][e] = values[name]
    return arrays


@inlined
def load_elements(arrays: Any, width: int) -> Elements:
    """Return all elements of a record of `elements_dtype(width)`, a lane for each; `width` is a literal."""
    return Elements(
        (load(arrays.tau_c[0], width), load(arrays.tau_c[1], width)),
        (load(arrays.tau_s[0], width), load(arrays.tau_s[1], width)),
        load(arrays.inverse_omega_s, width),
        load(arrays.delta, width),
        load(arrays.c0, width),
        load(arrays.c1, width),
        load(arrays.c2, width),
        load(arrays.inverse_omega_d, width),
        load(arrays.alpha, width),
    )


@inlined
def lane_of(element: Elements, index: int) -> Elements:
    """Return one of several elements that are lanes, in plain numbers."""
    return Elements(
        (lane(element.tau_c[0], index), lane(element.tau_c[1], index)),
        (lane(element.tau_s[0], index), lane(element.tau_s[1], index)),
        lane(element.inverse_omega_s, index),
        lane(element.delta, index),
        lane(element.c0, index),
        lane(element.c1, index),
        lane(element.c2, index),
        lane(element.inverse_omega_d, index),
        lane(element.alpha, index),
    )


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
        elasto_plastic, its_torque = elasto_plastic_step(
            element, load(kinds.break_away, width), z, moving, step
        )
        new = select(elastic, elasto_plastic, new)
        torque = select(elastic, its_torque, torque)
    if kinds.blocks_used:
        store(state.deflection, new)
        store(state.torque, torque)
        for e in range(width):
            if kinds.blocked[e]:
                state.deflection[e], state.torque[e] = maxwell_slip_step(
                    lane_of(element, e), kinds.blocks, e, state.blocks[e], lane(velocity, e), step
                )
        new = load(state.deflection, width)
        torque = load(state.torque, width)
    return new, torque


@inlined
def bristles_torque(
    element: Any, kinds: Any, state: Any, z: Lanes, velocity: Lanes, width: int
) -> Lanes:
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
                state.torque[e] = (
                    0.5 * lane(c0, e) * weighted_squares(kinds.blocks, e, state.blocks[e])
                )
        energy = load(state.torque, width)
    return energy


def prescribed_torque(elements: Sequence[FrictionElement], velocity: Array, steps: Array) -> Array:
    """Return the friction torque of each element, the mean over each step, from undeflected bristles on, Nm.

    Args:
        elements: e elements; only their bristles are used, other parts are for the caller to refuse or to report.
        velocity: their input velocities, each held over its step, rad/s, shape (m, e).
        steps: s, shape (m,).

    Returns:
        Shape (m, e).
    """
    torque = np.empty_like(velocity)
    for e, element in enumerate(elements):
        constants = np.zeros(1, bristles_dtype(1))
        if element.bristles is not None:
            fill_bristles(constants[0], 0, element.bristles)
        _follow_bristles(
            element_arrays((element,)),
            constants,
            np.zeros(1, bristles_state_dtype(1)),
            np.ascontiguousarray(velocity[:, e]),
            steps,
            torque[:, e],
        )
    return torque


@kernel
def _follow_bristles(
    arrays: Any, constants: Any, states: Any, velocity: Array, steps: Array, torque: Array
) -> None:
    """Write the torque of one element with any bristles, the mean over each step of prescribed velocities, Nm."""
    element = load_elements(arrays[0], 1)
    kinds = constants[0]
    state = states[0]
    still = 0.0 * element.c0
    z = still
    for k in range(steps.size):
        if steps[k] > 0.0:
            z, mean = bristles_step(element, kinds, state, z, still + velocity[k], steps[k], 1)
        else:  # a mean over no time
            mean = bristles_torque(element, kinds, state, z, still + velocity[k], 1)
        torque[k] = lane(mean, 0)
