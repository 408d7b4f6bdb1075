"""The parts of several elements as compiled code sees them: constants and state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rx90_common.friction.bristles.step import bristles_dtype, bristles_state_dtype
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import fill_bristles
from rx90_common.friction.parts.load import fill_load, load_dtype
from rx90_common.friction.parts.ripple import fill_ripple, ripple_dtype
from rx90_common.friction.parts.scatter import fill_scatter, scatter_dtype
from rx90_common.friction.parts.temperature import fill_temperature, temperature_dtype, temperature_state_dtype


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
