"""Elasticity and play between a motor and what it moves, for each of the six drives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.entries import LEFT_OUT, Numbers, Other, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import quoted

MOTOR, LINK = "motor", "link"
SIDES = (MOTOR, LINK)
"""Of the elasticity, on which the friction of the joints may act."""

_ZEROS = (0.0,) * 6
_STIFFNESS = "6 numbers > 0, .inf for a rigid joint"
# rad: what a tooth and its gap take up of a wheel with 12 teeth. Gears of robots have an arc minute, 0.0003 rad, common
# planetary ones half a degree; more than this is a slip of the unit.
_MOST_PLAY = 0.5


def _are_stiffnesses(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 6:
        return False
    return all(isinstance(number, int | float) and not isinstance(number, bool) and number > 0 for number in value)


ELASTICITY = Group(
    "Elasticity and play of the gears, joint side; left out: rigid gears.",
    keys={
        "stiffness": Other(
            "Stiffness between the motor, seen through its gear, and what it moves; .inf where that is rigid.",
            "Nm/rad", accepted=_STIFFNESS, good=_are_stiffnesses,
            fragment={
                "type": "array", "minItems": 6, "maxItems": 6, "items": {"type": "number", "exclusiveMinimum": 0.0}
            },
        ),
        "damping": Numbers("Damping beside the stiffness.", "Nm s/rad", count=6, low=0.0, default=_ZEROS),
        "backlash": Numbers(
            "Play: the way, at the joint, from one flank to the other.", "rad", count=6, low=0.0, high=_MOST_PLAY,
            default=_ZEROS,
        ),
        "friction": Text("The side on which the friction of the joints acts.", choices=SIDES, default=MOTOR),
    },
    default=LEFT_OUT,
)  # fmt: skip
"""What a drives file may hold of it."""


@dataclass(frozen=True)
class Elasticity:
    """Between the motors and the links; every array has shape (6,), one value for each drive, joint side.

    Drive 6 turns with joints 5 and 6 together, so its elasticity lies between motor 6 and q5 + q6.

    Attributes:
        stiffness: Nm/rad; infinite for a rigid drive, which has neither damping nor play.
        damping: beside the stiffness, Nm s/rad; with play only where the flanks touch.
        backlash: play from one flank to the other, rad, up to 0.5.
        friction_side: MOTOR or LINK, where the friction of the joints acts.

    Raises:
        ConfigError: for values out of range, and damping or play of a rigid drive.
    """

    stiffness: Array = field(default_factory=lambda: np.full(6, math.inf))
    damping: Array = field(default_factory=lambda: np.zeros(6))
    backlash: Array = field(default_factory=lambda: np.zeros(6))
    friction_side: str = MOTOR

    def __post_init__(self) -> None:
        stiffness = np.asarray(self.stiffness)
        if stiffness.shape != (6,) or not np.all(stiffness > 0):
            raise ConfigError(f"elasticity: stiffness is {stiffness.tolist()}; accepted: {_STIFFNESS}")
        ranges = (("damping", math.inf, "6 finite numbers >= 0"),
                  ("backlash", _MOST_PLAY, f"6 numbers in [0, {_MOST_PLAY:g}]"))  # fmt: skip
        for name, most, accepted in ranges:
            value = np.asarray(getattr(self, name))
            if value.shape != (6,) or not np.all(np.isfinite(value) & (value >= 0) & (value <= most)):
                raise ConfigError(f"elasticity: {name} is {value.tolist()}; accepted: {accepted}")
            for i in np.flatnonzero((value > 0) & np.isinf(stiffness)):
                found = f"elasticity: {name}[{i}] is {value[i]:g}, stiffness[{i}] infinite"
                raise ConfigError(f"{found}; accepted: 0 for a rigid drive")
        if self.friction_side not in SIDES:
            accepted = f"one of {', '.join(SIDES)}"
            raise ConfigError(f"elasticity: friction is {quoted(self.friction_side)}; accepted: {accepted}")

    @classmethod
    def of_file(cls, block: Mapping[str, Any] | None) -> Elasticity:
        """Return what a block of a drives file says, checked by ELASTICITY; rigid drives for none."""
        if block is None:
            return cls()
        arrays = {name: np.array(block[name], dtype=np.float64) for name in ("stiffness", "damping", "backlash")}
        return cls(**arrays, friction_side=block["friction"])

    @property
    def elastic(self) -> Array:
        """Return which drives are, shape (6,), bool."""
        return np.isfinite(self.stiffness)
