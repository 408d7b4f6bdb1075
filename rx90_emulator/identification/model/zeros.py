"""What the searches for wrong encoder zeros share: the turns they try, and the zero that a turned joint stands for."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array

QUARTERS: Final = (-0.5 * math.pi, 0.5 * math.pi, math.pi)
"""Turns by which the zeros of URDF and encoder differ where they count from other poses, rad."""
SMALLEST: Final = 0.01
"""Error of a zero that counts, rad: elasticity and rounded geometry pass for less."""
STEP: Final = 1e-4
"""Of differences by an angle, rad."""


def encoder_error(shift: Array) -> Array:
    """Return the errors of zeros, within half a turn, for joints that stand further on than assumed by `shift`, rad.

    Recorded angles lose the zero, so that a joint which stands a further on has a zero that is a less.
    """
    return np.array([math.remainder(-value, 2.0 * math.pi) if value else 0.0 for value in shift.tolist()])
