"""The bristles of several elements in compiled code: constants, state, and the step of whichever kind each has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction.bristle import bristle_step, friction_torque
from rx90_common.friction.bristles.elasto_plastic import ElastoPlastic, elasto_plastic_step, elasto_plastic_torque
from rx90_common.friction.bristles.maxwell_slip import (
    MOST_BLOCKS,
    MaxwellSlip,
    block_arrays,
    blocks_dtype,
    maxwell_slip_step,
    maxwell_slip_torque,
)
from rx90_common.kernels.compiled import kernel

LUGRE: Final = 0
ELASTO_PLASTIC: Final = 1
MAXWELL_SLIP: Final = 2


def bristles_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the constants of `width` elements' bristles."""
    return np.dtype(
        [
            ("kind", np.int64, width),
            ("break_away", np.float64, width),
            ("blocks", blocks_dtype(width)),
        ],
        align=True,
    )


def bristles_state_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of what the bristles of `width` elements remember beside one deflection for each element."""
    return np.dtype([("blocks", np.float64, (width, 2, MOST_BLOCKS))], align=True)


def fill_bristles(record: Any, kinds: Sequence[ElastoPlastic | MaxwellSlip | None]) -> None:
    """Write the kinds of elements into a record of `bristles_dtype(len(kinds))`; None is LuGre's bristle."""
    for e, kind in enumerate(kinds):
        if isinstance(kind, ElastoPlastic):
            record["kind"][e], record["break_away"][e] = ELASTO_PLASTIC, kind.break_away
        elif isinstance(kind, MaxwellSlip):
            record["kind"][e] = MAXWELL_SLIP
    record["blocks"] = block_arrays([kind if isinstance(kind, MaxwellSlip) else None for kind in kinds])[0]


@kernel
def kind_step(
    element: Any, constants: Any, index: int, blocks: NDArray[np.float64], z: float, velocity: float, step: float
) -> tuple[float, float]:
    """Advance the bristles of one element by `step` seconds at constant velocity.

    Args:
        element: an `Elements` of rx90_common.friction.bristle, in plain numbers.
        constants: record of `bristles_dtype`.
        index: of the element in it.
        blocks: of the element's state, shape (2, MOST_BLOCKS), advanced in place.
        z: deflection, rad; of blocks the mean by their stiffness.
        velocity: rad/s.
        step: s.

    Returns:
        The new deflection, rad, and the mean friction torque over the step, Nm.
    """
    kind = constants.kind[index]
    if kind == ELASTO_PLASTIC:
        return elasto_plastic_step(element, constants.break_away[index], z, velocity, step)
    if kind == MAXWELL_SLIP:
        return maxwell_slip_step(element, constants.blocks, index, blocks, velocity, step)
    return bristle_step(element, z, velocity, step)


@kernel
def kind_torque(
    element: Any, constants: Any, index: int, blocks: NDArray[np.float64], z: float, velocity: float
) -> float:
    """Return the friction torque of one element at an instant, Nm; arguments as those of `kind_step`."""
    kind = constants.kind[index]
    if kind == ELASTO_PLASTIC:
        return elasto_plastic_torque(element, constants.break_away[index], z, velocity)
    if kind == MAXWELL_SLIP:
        return maxwell_slip_torque(element, constants.blocks, index, blocks, velocity)
    return friction_torque(element, z, velocity)
