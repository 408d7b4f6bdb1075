"""Friction elements in compiled code: records and tuples of their parameters, steps of their bristles of all kinds.

`load_elements`, `one_element`, `lane_of` and `with_present` name every parameter once each; they are written here from
the declarations in FrictionElement, so that a new parameter needs no line of its own.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.elasto_plastic import elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.element import FRICTION_PARAMETERS, SIGNS, FrictionElement
from rx90_common.friction.maxwell_slip import (
    MAX_BLOCKS,
    blocks_dtype,
    maxwell_slip_step,
    maxwell_slip_torque,
    weighted_squares,
)
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import Lanes, lane, load, select, store

_SIGNED = {f"{'inverse_' * one.inverse}{one.name}": one.signed for one in FRICTION_PARAMETERS}

Elements: Any = namedtuple("Elements", list(_SIGNED))  # type: ignore[misc]  # declared in FrictionElement
"""One or more elements: numbers of one, or lanes of several; torques as (positive, negative), omega_s and omega_d as
`inverse_omega_s` and `inverse_omega_d`, the others by the names of FrictionElement."""


def elements_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of `width` elements as compiled code reads them: a struct of arrays, the element the last index.

    The fields are those of `Elements`. The torques have a row for each of SIGNS; v = 0 counts as positive.
    """
    shapes = {name: (len(SIGNS), width) if signed else (width,) for name, signed in _SIGNED.items()}
    return np.dtype([(name, np.float64, shape) for name, shape in shapes.items()], align=True)


def element_arrays(elements: Sequence[FrictionElement]) -> np.ndarray[Any, Any]:
    """Return elements as compiled code reads them, shape (1,), dtype `elements_dtype(len(elements))`."""
    arrays = np.zeros(1, elements_dtype(len(elements)))
    for name, parameter in zip(_SIGNED, FRICTION_PARAMETERS, strict=True):
        values = np.array([[getattr(element, name) for element in elements] for name in parameter.attributes])
        arrays[name] = 1.0 / values if parameter.inverse else values
    return arrays


def _written(decorate: Callable[[Any], Any], head: str, value: Callable[[str], str]) -> Any:
    """Return a compiled function with this head that gives Elements of `value` of each of their fields.

    Args:
        decorate: `kernel` or `inlined`.
        head: name and arguments.
        value: text of the value, for the name of a field, of torques with the index of the sign.
    """
    given = [
        f"({value(f'{name}[0]')}, {value(f'{name}[1]')})" if signed else value(name) for name, signed in _SIGNED.items()
    ]
    source = compile(f"def {head}:\n    return Elements({', '.join(given)})\n", __file__, "exec")
    scope = {"Elements": Elements, "load": load, "lane": lane, "__name__": __name__}
    exec(source, scope)
    return decorate(scope[head.partition("(")[0]])


def _place(name: str) -> str:
    """Return the text of one element's place in a record, for the name of a field."""
    return f"arrays.{name.replace(']', ', index]')}" if name.endswith("]") else f"arrays.{name}[index]"


load_elements = _written(inlined, "load_elements(arrays, width)", lambda name: f"load(arrays.{name}, width)")
"""Return all elements of a record of `elements_dtype(width)`, a lane for each; `width` is a literal."""

one_element = _written(kernel, "one_element(arrays, index)", _place)
"""Return one element of such a record, in plain numbers."""

lane_of = _written(inlined, "lane_of(element, index)", lambda name: f"lane(element.{name}, index)")
"""Return one of several elements that are lanes, in plain numbers."""

_PRESENT = ("tau_c", "tau_s", "inverse_omega_s", "c2")
with_present = _written(
    inlined,
    f"with_present(element, {', '.join(_PRESENT)})",
    lambda name: name if name.partition("[")[0] in _PRESENT else f"element.{name}",
)
"""Return elements with others in place of those that the parts change from step to step."""


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
    constants = np.zeros(1, bristles_dtype(1))
    state = np.zeros(1, BRISTLE_STATE_DTYPE)
    fill_bristles(constants[0], [element.bristles])
    torque = np.empty_like(velocity)
    deflection = np.empty_like(velocity)
    follow_bristles(element_arrays((element,)), constants, state, velocity, steps, torque, deflection)
    return torque


@kernel
def _bristles(arrays: NDArray[np.void], velocity: Array, steps: Array, torque: Array) -> None:
    """Write the friction torque of each element over each step of prescribed velocities, shape (m, e)."""
    for e in range(torque.shape[1]):
        element = one_element(arrays[0], e)
        z = 0.0
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
    element = load_elements(arrays[0], 1)
    kinds = constants[0]
    state = states[0].bristles
    z = load(states[0].z, 1)
    still = 0.0 * z
    for k in range(steps.size):
        if steps[k] > 0.0:
            z, mean = bristles_step(element, kinds, state, z, still + velocity[k], steps[k], 1)
        else:  # a mean over no time
            mean = bristles_torque(element, kinds, state, z, still + velocity[k], 1)
        torque[k] = lane(mean, 0)
        deflection[k] = lane(z, 0)
