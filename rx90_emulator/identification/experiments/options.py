"""The options of an excitation run, which --help shows too, so that this module imports nothing slow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from rx90_common.base.errors import ConfigError
from rx90_common.description.wall import Wall

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
