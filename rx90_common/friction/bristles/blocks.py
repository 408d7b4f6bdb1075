"""The blocks of Maxwell slip as compiled code has them: a record, and lanes of one element."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, load

MOST_BLOCKS: Final = 10
"""Of an element."""


class MaxwellBlocks(NamedTuple):
    """The blocks of one element, a lane for each of MOST_BLOCKS: those that are not there have no stiffness.

    Attributes:
        stiffness: in parts of c0.
        reach: deflection of steady sliding in parts of g(v), share / stiffness.
        attraction: Nm/s, a plain number.
    """

    stiffness: Lanes
    reach: Lanes
    attraction: float


def blocks_dtype(width: int) -> np.dtype[np.void]:
    """Return the type of the blocks of `width` elements, the element the first index."""
    each = (width, MOST_BLOCKS)
    return np.dtype(
        [("stiffness", np.float64, each), ("reach", np.float64, each), ("attraction", np.float64, (width,))], align=True
    )


@inlined
def load_blocks(arrays: Any, index: int) -> MaxwellBlocks:
    """Return the blocks of one element of such a record."""
    return MaxwellBlocks(
        load(arrays.stiffness[index], MOST_BLOCKS), load(arrays.reach[index], MOST_BLOCKS), arrays.attraction[index]
    )


@inlined
def weighted_squares(arrays: Any, index: int, state: NDArray[np.float64]) -> float:
    """Return the sum of stiffness, in parts of c0, times squared deflection, rad^2, over the blocks of one element."""
    total = 0.0
    for k in range(MOST_BLOCKS):
        total += arrays.stiffness[index, k] * state[0, k] * state[0, k]
    return total
