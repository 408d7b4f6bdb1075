"""Values of V+, and the variables that hold them.

A value is a real (float), a string (str), a transformation (SE3, mm), a precision point (`Joints`, degrees) or
a format of TYPE. Reals are doubles here; the cabinet's are single.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from pinocchio import SE3

from rx90_common.base.errors import Rx90Error
from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.errors import VplusError

_LARGEST_INDEX = 32767
_LARGEST = 1e38
_LONGEST = 128
_NAME_LENGTH = 15


class LoadError(Rx90Error):
    """A file whose programs cannot be executed.

    Attributes:
        faults: all faults of the file, each with its line.
    """

    def __init__(self, faults: list[str]) -> None:
        super().__init__(f"{faults[0]} (faults: {len(faults)})")
        self.faults = faults


@dataclass(frozen=True)
class Format:
    """A format of TYPE or $ENCODE, such as F8.2."""

    text: str


Value: TypeAlias = float | str | Joints | SE3 | Format
KINDS = {
    float: "real",
    str: "string",
    Joints: "precision point",
    SE3: "transformation",
    Format: "format",
}
"""What values are, in words."""


def bounded(result: object) -> Value:
    """Return what a function gives as a value that V+ can hold.

    Raises:
        VplusError: if it is too large, too long, or no number.
    """
    if isinstance(result, bool | np.bool_):
        return -float(result) + 0.0
    if isinstance(result, int | float):
        if not abs(result) <= _LARGEST:
            raise VplusError("Arithmetic overflow", f"{result:g}")
        return float(result)
    if isinstance(result, str) and len(result) > _LONGEST:
        raise VplusError("String too long", f"{len(result)} characters; accepted: up to {_LONGEST}")
    return result


@dataclass
class Variable:
    """A variable or an element of an array; a value of None is an undefined one."""

    name: str
    value: Value | None = None

    def store(self, value: Value) -> None:
        """Store a value of the kind that the name is for.

        Raises:
            VplusError: for another kind than that of the name or of the value that is there.
        """
        wanted = {"$": "string", "#": "precision point"}.get(self.name[0], "real or transformation")
        if self.value is not None:
            wanted = KINDS[type(self.value)]
        kind = KINDS[type(value)]
        if kind not in wanted:
            raise VplusError(
                "Illegal assignment", f"{self.name} is a {wanted}, and the value a {kind}"
            )
        self.value = value


def plain_name(name: str) -> str:
    """Return a name as it counts."""
    return name.lower()[:_NAME_LENGTH]


Index: TypeAlias = tuple[int, ...]
Table: TypeAlias = dict[Index, Variable]
"""An array: its elements by their index; a plain variable has the index ()."""
Scope: TypeAlias = dict[str, Table]


def element(table: Table, name: str, index: Index = ()) -> Variable:
    """Return an element of an array, made on first use.

    Raises:
        VplusError: for an index that no array has.
    """
    if len(index) > 3 or not all(0 <= number <= _LARGEST_INDEX for number in index):
        raise VplusError("Illegal array index", f"{name}{list(index)}")
    shown = f"{name}[{','.join(map(str, index))}]" if index else name
    return table.setdefault(index, Variable(shown))
