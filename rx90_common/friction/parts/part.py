"""What all parts of a friction element have in common: a table of what a file may hold, checks, and their words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Final

from rx90_common.base.entries import REQUIRED, Entry, ListOf, Number
from rx90_common.base.groups import Group
from rx90_common.base.section import Section, range_text

LEAST_SPEED: Final = 1e-9
"""Of Stribeck and fading velocities, rad/s: an arm that goes so far in a second stands, and 1 / v is still a number."""


@dataclass(frozen=True)
class FrictionPart:
    """A block of a friction element; its fields are the keys of its table, with the same defaults.

    Attributes:
        name: key of the block in a friction file, and attribute of FrictionElement.
        table: what the block may hold.

    Raises:
        ConfigError: for a value that is not in its range, naming block, key, value and range.
    """

    name: ClassVar[str]
    table: ClassVar[Group]

    def __post_init__(self) -> None:
        section = Section(dict(self._as_in_file()), Path(self.name))
        for key, entry in self.table.keys.items():
            value = entry.take(section, key)
            if isinstance(value, float | tuple):  # as a file gives it: no NumPy scalar, which writers do not know
                object.__setattr__(self, key, value)

    @classmethod
    def entry(cls) -> Entry:
        """Return what a file may hold under the name."""
        return cls.table

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> FrictionPart:
        """Return the part of what `entry` read.

        Raises:
            ConfigError: as the part itself.
        """
        return cls(**content)

    @property
    def least_factor(self) -> float:
        """Return the least number that the part may multiply Coulomb and static torque with; 1 if it only adds."""
        return 1.0

    @property
    def leaves_less(self) -> bool:
        """Return whether the part may leave less of Coulomb and static torque than the element has."""
        return self.least_factor < 1.0

    def weakest(self, element: Any) -> Any:
        """Return an element that has nowhere more friction than this FrictionElement may have by the part."""
        return element

    def values(self) -> dict[str, Any]:
        """Return the block as it stands in a file, without what has its default."""
        entries = self.table.keys
        return {key: value for key, value in self._as_in_file() if value != _plain(entries[key].default)}

    def numbers(self) -> dict[str, Any]:
        """Return all values by their names, those of a list one by one: share[0]."""
        found: dict[str, Any] = {}
        for key, value in self._as_in_file():
            found |= {f"{key}[{i}]": each for i, each in enumerate(value)} if isinstance(value, list) else {key: value}
        return found

    def _as_in_file(self) -> Iterator[tuple[str, Any]]:
        return ((field.name, _plain(getattr(self, field.name))) for field in fields(self))

    @classmethod
    def units(cls) -> dict[str, str]:
        """Return the units of the fields."""
        return {key: entry.unit for key, entry in cls.table.keys.items()}

    @classmethod
    def legend(cls) -> str:
        """Return the table as lines of comment, as they stand at the head of friction files."""
        lines = f"# {cls.name:<8} {cls.table.about[0].lower()}{cls.table.about[1:-1]}:\n"
        for key, entry in cls.table.keys.items():
            optional = "" if entry.default is REQUIRED else f"; {_default(entry)} if it is left out"
            lines += (
                f"#   {key:<18} {entry.about[0].lower()}{entry.about[1:-1]}, {entry.unit}{_range(entry)}{optional}\n"
            )
        return lines


def _plain(value: Any) -> Any:
    """Return a value as YAML has it."""
    return [float(each) for each in value] if isinstance(value, tuple) else value


def _default(entry: Entry) -> str:
    return f"{entry.default:g}" if isinstance(entry.default, float) else "none"


def _range(entry: Entry) -> str:
    number = entry.item if isinstance(entry, ListOf) else entry
    if not isinstance(number, Number) or (number.low, number.high) == (-math.inf, math.inf):
        return ""
    return f", {range_text(number.low, number.high, number.above).rpartition('number ')[2]}"
