"""Values of V+ and the places that hold them: cells, arrays, scopes.

A value is a real (float), a string (str), a transformation (4 x 4 array, mm) or a precision point (`Joints`, degrees).
Reals are doubles here; the cabinet's are single.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias, TypeVar

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.vplus.errors import VplusError

TRUE = -1.0
FALSE = 0.0
_LARGEST_INDEX = 32767
_DIMENSIONS = 3


class Joints(tuple[float, ...]):
    """Joint values of a precision point, degrees."""

    __slots__ = ()


Value: TypeAlias = "float | str | Joints | Array"
Index: TypeAlias = "tuple[int, ...]"
Held = TypeVar("Held", bound="Cell | Table")


def kind_of(value: Value) -> str:
    """Return what a value is, in words."""
    if isinstance(value, str):
        return "string"
    if isinstance(value, Joints):
        return "precision point"
    return "transformation" if isinstance(value, np.ndarray) else "real"


@dataclass
class Cell:
    """A variable or an element of an array; None: undefined."""

    value: Value | None = None

    def store(self, name: str, value: Value) -> None:
        """Store a value of the kind that the name is for.

        Raises:
            VplusError: for another kind than that of the name or of the value that is there.
        """
        kind = kind_of(value)
        wanted = {"$": "string", "#": "precision point"}.get(name[0])
        if wanted is None:
            wanted = "real or transformation" if self.value is None else kind_of(self.value)
        if kind not in wanted:
            raise VplusError("Illegal assignment", f"{name} is a {wanted}, and the value a {kind}")
        self.value = value


@dataclass
class Table:
    """An array: its elements by their index; those that nothing was stored in are undefined."""

    cells: dict[Index, Cell] = field(default_factory=dict)

    def cell(self, name: str, index: Index) -> Cell:
        """Return an element, made on first use.

        Raises:
            VplusError: for an index that no array has.
        """
        if len(index) > _DIMENSIONS or not all(0 <= number <= _LARGEST_INDEX for number in index):
            raise VplusError("Illegal array index", f"{name}{list(index)}")
        return self.cells.setdefault(index, Cell())

    def last(self) -> float:
        """Return the highest index in use, -1 for an array without elements."""
        return float(max((index[-1] for index, cell in self.cells.items() if cell.value is not None), default=-1))


@dataclass
class Scope:
    """Variables by their names, global ones or those of a program."""

    cells: dict[str, Cell] = field(default_factory=dict)
    tables: dict[str, Table] = field(default_factory=dict)

    def cell(self, name: str) -> Cell:
        """Return a variable, made on first use."""
        return self.cells.setdefault(name, Cell())

    def table(self, name: str) -> Table:
        """Return an array, made on first use."""
        return self.tables.setdefault(name, Table())

    def values(self) -> Iterator[tuple[str, Value]]:
        """Yield names, of elements with their index, and values of all that is defined."""
        for name, cell in sorted(self.cells.items()):
            if cell.value is not None:
                yield name, cell.value
        for name, table in sorted(self.tables.items()):
            for index, cell in sorted(table.cells.items()):
                if cell.value is not None:
                    yield f"{name}[{','.join(map(str, index))}]", cell.value
