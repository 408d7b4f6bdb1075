"""Elements with parts, compiled: constants and state, the parameters at a moment, and the step of the bristles.

`width`, a literal, is the number of elements in the records; velocity and angle are lanes of that width.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np

from rx90_common.base.arrays import RecordType, record_type
from rx90_common.friction.compiled_elements import (
    Elements,
    bristles_energy,
    bristles_step,
    bristles_torque,
    load_elements,
)
from rx90_common.friction.element import PARTS, FrictionElement
from rx90_common.friction.parts.part import Moment, Present, Surroundings
from rx90_common.friction.parts.temperature import start_temperatures
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, fma, load


def parts_dtype(width: int) -> RecordType:
    """Return the type of the constants of the parts of `width` elements, the element the last index."""
    constants = [(name, part.constants(width)) for name, part in PARTS.items()]
    return record_type(*constants, used=np.int64)  # used: 1 if any element has any part


def parts_state_dtype(width: int) -> RecordType:
    """Return the type of the state of the parts of `width` elements."""
    return record_type(
        *((name, part.state(width)) for name, part in PARTS.items() if part.state is not None),
        friction=width,  # torque of the last step, Nm
        transmitted=width,  # workspace: in the middle of the last step, Nm
    )


def fill_parts(
    record: Any,
    elements: Sequence[FrictionElement],
    gear: Sequence[float],
    period: float,
    seed: int,
    motor_heat: Sequence[float] | None = None,
) -> None:
    """Write the constants of elements' parts into a record of `parts_dtype(len(elements))`, zero before.

    Args:
        record: that is filled.
        elements: with their parts.
        gear: turns of the motor for a turn of each element.
        period: of a tick, s.
        seed: of the scatter.
        motor_heat: of the motors that drive the elements, W for the square of the torque in Nm, e numbers; none if
            left out.
    """
    record["used"] = int(any(element.parts for element in elements))
    surroundings = Surroundings(gear, period, seed, motor_heat or [0.0] * len(elements))
    for e, element in enumerate(elements):
        for name, part in element.parts.items():
            PARTS[name].fill(record[name], e, part, surroundings)


def _of_parts(name: str) -> Any:
    """Return a function for kernels that calls a function of all parts, each with what the one before has returned."""
    return reduce(_both, filter(None, (getattr(part, name) for part in PARTS.values())))


def _both(first: Any, second: Any) -> Any:
    @inlined
    def both(parts: Any, state: Any, before: Any, at: Any, width: int) -> Any:
        return second(parts, state, first(parts, state, before, at, width), at, width)

    return both


advance_parts = _of_parts("advance")
"""Advance the parts by a step of the plant, s, with the torques that were transmitted in it, Nm."""

tick_parts = _of_parts("tick")
"""Advance the parts by a tick, s; temperatures have a function of their own."""

settle_parts = _of_parts("settle")
"""Begin anew, but for the temperatures, with the torques that are transmitted then, Nm; the step is 0."""

_presented = _of_parts("present")


@inlined
def reset_parts(parts: Any, state: Any, transmitted: Lanes, width: int) -> None:
    """Begin anew, with the torques that are transmitted then, Nm."""
    start_temperatures(parts.temperature, state.temperature, width)
    settle_parts(parts, state, transmitted, 0.0, width)


@inlined
def effective_elements(
    arrays: Any, parts: Any, state: Any, angle: Lanes, velocity: Lanes, ahead: float, width: int
) -> Any:
    """Return the parameters that the elements have `ahead` seconds after the last step, at an angle and a velocity."""
    element = load_elements(arrays, width)
    own = Present(
        element.tau_c, element.tau_s, element.inverse_omega_s, element.c2, 1.0 + 0.0 * angle,
        0.0 * angle, 0.0 * angle,
    )  # fmt: skip
    moment = Moment(angle, velocity, element.delta, ahead)
    present = _presented(parts, state, own, moment, width)
    return Elements(
        (
            fma(present.tau_c[0], present.scale, present.coulomb),
            fma(present.tau_c[1], present.scale, present.coulomb),
        ),
        (
            fma(present.tau_s[0], present.scale, present.static),
            fma(present.tau_s[1], present.scale, present.static),
        ),
        present.inverse_omega_s,
        element.delta,
        element.c0,
        element.c1,
        present.c2,
        element.inverse_omega_d,
        element.alpha,
    )


@inlined
def parts_step(
    arrays: Any,
    parts: Any,
    state: Any,
    z: Lanes,
    angle: Lanes,
    velocity: Lanes,
    step: float,
    width: int,
) -> tuple[Lanes, Lanes]:
    """Advance the bristles by `step` seconds, angle, rad, and velocity, rad/s, being those of its middle.

    Returns:
        The new deflection, rad, and the friction torque averaged over the step, Nm.
    """
    element = effective_elements(arrays, parts, state, angle, velocity, 0.5 * step, width)
    return bristles_step(element, parts.bristles, state.bristles, z, velocity, step, width)


@inlined
def parts_torque(
    arrays: Any, parts: Any, state: Any, z: Lanes, angle: Lanes, velocity: Lanes, width: int
) -> Lanes:
    """Return the friction torque at the end of the last step, Nm."""
    element = effective_elements(arrays, parts, state, angle, velocity, 0.0, width)
    return bristles_torque(element, parts.bristles, state.bristles, z, velocity, width)


@inlined
def parts_energy(arrays: Any, parts: Any, state: Any, z: Lanes, width: int) -> Lanes:
    """Return the energy stored in the bristles, J."""
    return bristles_energy(load(arrays.c0, width), parts.bristles, state.bristles, z, width)
