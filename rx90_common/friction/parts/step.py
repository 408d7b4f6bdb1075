"""Elements with parts, compiled: constants and state, the parameters at a moment, and the step of the bristles.

`width`, a literal, is the number of elements in the records; velocity and angle are lanes of that width.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rx90_common.friction.compiled_elements import (
    bristles_dtype,
    bristles_energy,
    bristles_state_dtype,
    bristles_step,
    bristles_torque,
    load_elements,
    reset_bristles,
    with_present,
)
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.friction.parts.load import fill_load, load_dtype, load_torques
from rx90_common.friction.parts.ripple import fill_ripple, ripple_dtype, ripple_factor
from rx90_common.friction.parts.scatter import fill_scatter, scatter_dtype, start_scatter
from rx90_common.friction.parts.temperature import (
    fill_temperature,
    start_temperatures,
    temperature_dtype,
    temperature_state_dtype,
    warm_static,
)
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, fma, load, store


def parts_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the constants of the parts of `width` elements, the element the last index."""
    return np.dtype(
        [
            ("used", np.int64),  # 1 if any element has any part
            ("load", load_dtype(width)),
            ("temperature", temperature_dtype(width)),
            ("ripple", ripple_dtype(width)),
            ("scatter", scatter_dtype(width)),
            ("bristles", bristles_dtype(width)),
        ],
        align=True,
    )


def parts_state_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the state of the parts of `width` elements."""
    return np.dtype(
        [
            ("load", np.float64, (width,)),  # transmitted torque, Nm
            ("load_slope", np.float64, (width,)),  # over the last step, Nm/s
            ("friction", np.float64, (width,)),  # torque of the last step, Nm
            ("transmitted", np.float64, (width,)),  # workspace: in the middle of the last step, Nm
            ("temperature", temperature_state_dtype(width)),
            ("scatter_counter", np.uint64, (width,)),
            ("scatter_walk", np.float64, (width,)),
            ("scatter_factor", np.float64, (width,)),
            ("bristles", bristles_state_dtype(width)),
        ],
        align=True,
    )


def fill_parts(
    record: Any,
    elements: Sequence[FrictionElement],
    gear: Sequence[float],
    period: float,
    seed: int,
    motor_heat: Sequence[float] = (),
) -> None:
    """Write the parts of elements into a record of `parts_dtype(len(elements))`, zero before.

    Args:
        record: to write into.
        elements: e elements.
        gear: turns of the motor for a turn of each element, e numbers.
        period: of a tick, s.
        seed: of the scatter.
        motor_heat: of the motors that drive the elements, W for the square of the torque in Nm, e numbers; none if
            left out.
    """
    record["used"] = int(any(element.parts for element in elements))
    fill_load(record["load"], [element.load for element in elements])
    fill_temperature(
        record["temperature"], [element.temperature for element in elements], period,
        motor_heat or [0.0] * len(elements),
    )  # fmt: skip
    fill_ripple(record["ripple"], [element.ripple for element in elements], gear)
    fill_scatter(record["scatter"], [element.scatter for element in elements], period, seed)
    fill_bristles(record["bristles"], [element.bristles for element in elements])


@inlined
def reset_parts(parts: Any, state: Any, transmitted: Lanes, width: int) -> None:
    """Begin anew, with the torques that are transmitted then, Nm."""
    start_temperatures(parts.temperature, state.temperature, width)
    settle_parts(parts, state, transmitted)


@inlined
def settle_parts(parts: Any, state: Any, transmitted: Lanes) -> None:
    """Begin anew, but for the temperatures."""
    store(state.load, transmitted)
    store(state.load_slope, 0.0 * transmitted)
    start_scatter(parts.scatter, state)
    reset_bristles(state.bristles)


@inlined
def effective_elements(
    arrays: Any, parts: Any, state: Any, angle: Lanes, velocity: Lanes, ahead: float, width: int
) -> Any:
    """Return the parameters that the elements have `ahead` seconds after the last step, at an angle and a velocity."""
    element = load_elements(arrays, width)
    scale = ripple_factor(parts.ripple, angle, width) * load(state.scatter_factor, width)
    transmitted = fma(ahead, load(state.load_slope, width), load(state.load, width))
    coulomb, static = load_torques(parts.load, transmitted, velocity, element.delta, width)
    still = (
        warm_static(state.temperature, element.tau_c[0], element.tau_s[0], width),
        warm_static(state.temperature, element.tau_c[1], element.tau_s[1], width),
    )
    return with_present(
        element,
        (fma(element.tau_c[0], scale, coulomb), fma(element.tau_c[1], scale, coulomb)),
        (fma(still[0], scale, static), fma(still[1], scale, static)),
        element.inverse_omega_s * load(state.temperature.speed, width),
        element.c2 * load(state.temperature.viscous, width),
    )


@inlined
def parts_step(
    arrays: Any, parts: Any, state: Any, z: Lanes, angle: Lanes, velocity: Lanes, step: float, width: int
) -> tuple[Lanes, Lanes]:
    """Advance the bristles by `step` seconds, angle, rad, and velocity, rad/s, being those of its middle.

    Returns:
        The new deflection, rad, and the friction torque averaged over the step, Nm.
    """
    element = effective_elements(arrays, parts, state, angle, velocity, 0.5 * step, width)
    return bristles_step(element, parts.bristles, state.bristles, z, velocity, step, width)


@inlined
def parts_torque(arrays: Any, parts: Any, state: Any, z: Lanes, angle: Lanes, velocity: Lanes, width: int) -> Lanes:
    """Return the friction torque at the end of the last step, Nm."""
    element = effective_elements(arrays, parts, state, angle, velocity, 0.0, width)
    return bristles_torque(element, parts.bristles, state.bristles, z, velocity, width)


@inlined
def parts_energy(arrays: Any, parts: Any, state: Any, z: Lanes, width: int) -> Lanes:
    """Return the energy stored in the bristles, J."""
    return bristles_energy(load(arrays.c0, width), parts.bristles, state.bristles, z, width)
