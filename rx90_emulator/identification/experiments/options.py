"""The options of an excitation run, which --help shows too, so that this module imports nothing slow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from rx90_common.base.errors import ConfigError, IdentificationError

_FARTHEST = 1000.0  # m, of a plane from the base


@dataclass(frozen=True)
class Wall:
    """A plane of which the arm stays on one side.

    Attributes:
        normal: unit vector in the base's frame, shape (3,), pointing to the side where the arm may be.
        distance: normal @ x for points x of the plane, m.
        name: for messages.
    """

    normal: tuple[float, ...]
    distance: float
    name: str

    @classmethod
    def above(cls, height: float) -> Wall:
        """Return a horizontal table at a height, m, over the base's origin; refuses as `through`."""
        return cls.through((0.0, 0.0, 1.0, height), f"--keep-above {height:g}")

    @classmethod
    def through(cls, numbers: Sequence[float], name: str = "") -> Wall:
        """Return the wall n x = d for four numbers n, d, with n of any length: the arm stays where n x > d."""
        name = name or f"--wall {' '.join(f'{number:g}' for number in numbers)}"
        length = math.hypot(*numbers[:3])
        if not (len(numbers) == 4 and length > 0.0 and math.isfinite(sum(numbers))):
            raise IdentificationError(f"{name}; accepted: NX NY NZ D, of which the first three are not all 0")
        distance = numbers[3] / length
        if not abs(distance) <= _FARTHEST:
            raise IdentificationError(f"{name}: {abs(distance):g} m from the base; accepted: up to {_FARTHEST:g} m")
        return cls(tuple(number / length for number in numbers[:3]), distance, name)


RANGES = MappingProxyType({
    "period": (1.0, 600.0, "s, of the base frequency"),
    "share": (0.05, 1.0, "of the limits of speed, acceleration and torque that may be used"),
    "seed": (0, 2**31, "of the random motions that the search begins with; the same seed gives the same plan"),
    "clearance": (0.0, 10.0, "m, least distance to table and walls"),
})  # fmt: skip
"""Least and greatest value of each option that a user may set, and its meaning."""


@dataclass(frozen=True)
class ExcitationOptions:
    """The options of a plan; `RANGES` declares the others.

    Attributes:
        walls: planes that links and tool stay clear of.
        tempos: at which the optimised series is played, each with its number of periods.
        harmonics: of the base frequency in each joint's series.
        steps: of the search.
    """

    period: float = 12.0
    share: float = 0.8
    seed: int = 0
    clearance: float = 0.02
    walls: tuple[Wall, ...] = ()
    tempos: tuple[tuple[float, int], ...] = ((1.0, 3), (0.5, 2), (0.2, 1))
    harmonics: int = 10
    steps: int = 60

    def __post_init__(self) -> None:
        for name, (low, high, _) in RANGES.items():
            value = vars(self)[name]
            if not low <= value <= high:
                raise ConfigError(f"--{name} is {value}; accepted: {low:g} to {high:g}")


QUICK: Mapping[str, Any] = MappingProxyType({"tempos": ((1.0, 1),), "steps": 15})
"""Options of a short plan."""
