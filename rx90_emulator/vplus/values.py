"""Values of V+, the variables that hold them, and the errors that stop a program.

A value is a real (float), a string (str), a transformation (SE3, mm), a precision point (`Joints`, degrees) or
a format of TYPE. Reals are doubles here; the cabinet's are single. Texts of errors are better known than their numbers:
both are from memory of the manuals, and every message says so of its number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from pinocchio import SE3

from rx90_common.base.errors import FailureError, Rx90Error

NUMBERS = {
    "Program not executable": -307,
    "Undefined value": -401,
    "Illegal value": -402,
    "Illegal array index": -404,
    "Undefined program or variable name": -406,
    "Not enough program stack space": -413,
    "Missing argument": -454,
    "Robot power off": -604,
    "Location out of range": -610,
    "Straight-line motion can't alter configuration": -612,
    "Location too close": -618,
    "Time-out nulling errors": -1003,
    "Soft envelope error": -1006,
    "Position out of range": -1023,
}
_LARGEST_INDEX = 32767
_LARGEST = 1e38
_LONGEST = 128
_NAME_LENGTH = 15


class VplusError(FailureError):
    """What stops a program while it runs.

    Attributes:
        text: V+'s text; an asterisk in it ends the part that is between asterisks when it is shown.
        detail: what it is about; empty for nothing.
        where: program, step and line; empty until the interpreter adds it.
    """

    def __init__(self, text: str, detail: str = "") -> None:
        super().__init__(text)
        self.text, _, self._joint = text.partition("*")
        self.detail = detail
        self.where = ""

    @property
    def number(self) -> int:
        """Return V+'s number, from memory; -300 where none is known."""
        return NUMBERS.get(self.text, -300)

    @property
    def message(self) -> str:
        """Return the text as V+ shows it, such as `*Undefined value*` or `*Position out of range* Jt 2`."""
        return f"*{self.text}*{self._joint}"

    def __str__(self) -> str:
        """Return the whole message."""
        number = f" ({self.number}, number from memory)" if self.text in NUMBERS else ""
        detail = f": {self.detail}" if self.detail else ""
        where = f"; {self.where}" if self.where else ""
        return f"{self.message}{number}{detail}{where}"


class LoadError(Rx90Error):
    """A file whose programs cannot be executed.

    Attributes:
        faults: all faults of the file, each with its line.
    """

    def __init__(self, faults: list[str]) -> None:
        super().__init__(f"{faults[0]} (faults: {len(faults)})")
        self.faults = faults


class Joints(tuple[float, ...]):
    """Joint values of a precision point, degrees."""

    __slots__ = ()


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
