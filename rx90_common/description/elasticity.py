"""Elasticity and play between a motor and what it moves, for each of the six drives."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.declared import Declared
from rx90_common.base.entries import REQUIRED, Numbers, Other, Text
from rx90_common.base.errors import ConfigError

MOTOR, LINK = "motor", "link"
SIDES = (MOTOR, LINK)
"""Of the elasticity, on which the friction of the joints may act."""

_STIFFNESS = "6 numbers > 0, .inf for a rigid joint"
# rad: what a tooth and its gap take up of a wheel with 12 teeth. Gears of robots have an arc minute, 0.0003 rad, common
# planetary ones half a degree; more than this is a slip of the unit.
_MOST_PLAY = 0.5


def _are_stiffnesses(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 6:
        return False
    return all(isinstance(number, int | float) and not isinstance(number, bool) and number > 0 for number in value)


_rigid_or_soft = Other(
    "Stiffness between the motor, seen through its gear, and what it moves; .inf where that is rigid.", "Nm/rad",
    accepted=_STIFFNESS, good=_are_stiffnesses,
    fragment={"type": "array", "minItems": 6, "maxItems": 6, "items": {"type": "number", "exclusiveMinimum": 0.0}},
)  # fmt: skip
_play = Numbers("Play: the way, at the joint, from one flank to the other.", "rad", count=6, low=0.0, high=_MOST_PLAY)


@dataclass(frozen=True)
class Elasticity(Declared):
    """Between the motors and the links; every array has shape (6,), one value for each drive, joint side.

    Drive 6 turns with joints 5 and 6 together, so its elasticity lies between motor 6 and q5 + q6. With play the
    damping acts only where the flanks touch.

    Raises:
        ConfigError: for values out of range, and damping or play of a rigid drive.
    """

    name = "elasticity"
    about = "Elasticity and play of the gears, joint side; left out: rigid gears."

    stiffness: Annotated[Array, _rigid_or_soft, REQUIRED] = field(default_factory=lambda: np.full(6, math.inf))
    damping: Annotated[Array, Numbers("Damping beside the stiffness.", "Nm s/rad", count=6, low=0.0)] = field(
        default_factory=lambda: np.zeros(6)
    )
    backlash: Annotated[Array, _play] = field(default_factory=lambda: np.zeros(6))
    friction_side: Annotated[
        str, Text("The side on which the friction of the joints acts.", choices=SIDES), "friction"
    ] = MOTOR

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("damping", "backlash"):
            value = getattr(self, name)
            for i in np.flatnonzero((value > 0) & np.isinf(self.stiffness)):
                found = f"elasticity: {name}[{i}] is {value[i]:g}, stiffness[{i}] infinite"
                raise ConfigError(f"{found}; accepted: 0 for a rigid drive")

    @property
    def elastic(self) -> Array:
        """Return which drives are, shape (6,), bool."""
        return np.isfinite(self.stiffness)
