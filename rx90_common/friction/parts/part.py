"""Common base of all parts of a friction element: accepted contents of files, and their descriptions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rx90_common.base.declared import Declared, declarations, in_file
from rx90_common.base.entries import LEFT_OUT, REQUIRED, Entry, ListOf, Number, range_text

MIN_SPEED: Final = 1e-9
"""Least Stribeck and fading velocity, rad/s: rest for all practical purposes, while 1 / v is still a number."""
LINEAR_SPEED: Final = 1e-3
"""The speed, rad/s, below which the viscous part is linear whatever its exponent: motion this slow is presliding."""


@dataclass(frozen=True)
class FrictionPart(Declared):
    """A block of a friction element, under its name in a friction file and as an attribute of FrictionElement."""

    @classmethod
    def entry(cls) -> Entry:
        """Return the accepted content of a file under the name."""
        return cls.group(LEFT_OUT)

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> FrictionPart:
        """Return the part for the values that `entry` has read."""
        return cls.of_file(content)

    @property
    def least_factor(self) -> float:
        """Return the least number that the part may multiply Coulomb and static torque with; 1 if it only adds."""
        return 1.0

    @property
    def lowers_friction(self) -> bool:
        """Return whether the part may leave less of Coulomb and static torque than the element has."""
        return self.least_factor < 1.0

    def weakest(self, element: Any) -> Any:
        """Return an element that has nowhere more friction than this FrictionElement may have by the part."""
        return element

    def values(self) -> dict[str, Any]:
        """Return the block as in a file, without default values."""
        own_entries = declarations(type(self)).values()
        return {
            one.name: in_file(getattr(self, one.name)) for one in own_entries if getattr(self, one.name) != one.default
        }

    def numbers(self) -> dict[str, Any]:
        """Return all values by their names, those of a list one by one: share[0]."""
        found: dict[str, Any] = {}
        for key in declarations(type(self)):
            value = in_file(getattr(self, key))
            found |= {f"{key}[{i}]": each for i, each in enumerate(value)} if isinstance(value, list) else {key: value}
        return found

    @classmethod
    def legend(cls) -> str:
        """Return the table as lines of comment, for the head of friction files."""
        lines = f"# {cls.name:<8} {in_words(cls.about)}:\n"
        for key, entry in cls.group().keys.items():
            optional = "" if entry.default is REQUIRED else f"; {_default(entry)} if it is left out"
            lines += f"#   {key:<18} {in_words(entry.about)}, {entry.unit}{_range(entry)}{optional}\n"
        return lines


def in_words(about: str) -> str:
    """Return the sentence about an entry as words within another one; names of people keep their capital."""
    start = about if about.startswith(("Coulomb", "Stribeck")) else about[0].lower() + about[1:]
    return start.removesuffix(".")


def _default(entry: Entry) -> str:
    return f"{entry.default:g}" if isinstance(entry.default, float) else "none"


def _range(entry: Entry) -> str:
    number = entry.item if isinstance(entry, ListOf) else entry
    if not isinstance(number, Number) or (number.low, number.high) == (-math.inf, math.inf):
        return ""
    return f", {range_text(number.low, number.high, number.above).rpartition('number ')[2]}"
