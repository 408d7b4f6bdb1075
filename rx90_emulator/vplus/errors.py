"""Errors with the texts of V+.

The texts are better known than the numbers: both are from memory of the manuals, and every message says so of its
number.
"""

from __future__ import annotations

from typing import Final

from rx90_common.base.errors import FailureError, Rx90Error

NUMBERS: Final = {
    "Program not executable": -307,
    "Undefined value": -401,
    "Illegal value": -402,
    "Illegal array index": -404,
    "Undefined program or variable name": -406,
    "Not enough program stack space": -413,
    "Missing argument": -454,
    "Robot not attached to this program": -602,
    "COMP mode disabled": -603,
    "Robot power off": -604,
    "Illegal joint number": -609,
    "Location out of range": -610,
    "Straight-line motion can't alter configuration": -612,
    "Location too close": -618,
    "Time-out nulling errors": -1003,
    "Soft envelope error": -1006,
    "Position out of range": -1023,
}


class VplusError(FailureError):
    """What stops a program while it runs.

    Attributes:
        text: V+'s text, without the asterisks.
        detail: what it is about; empty for nothing.
        where: program, step and line; empty until the interpreter adds it.
    """

    def __init__(self, text: str, detail: str = "", where: str = "") -> None:
        self.text = text
        self.detail = detail
        self.where = where
        super().__init__(text)

    @property
    def number(self) -> int:
        """Return V+'s number, from memory; -300 where none is known."""
        return NUMBERS.get(self.text.partition("*")[0], -300)

    @property
    def message(self) -> str:
        """Return the text as V+ shows it, such as `*Undefined value*` or `*Position out of range* Jt 2`."""
        text, _, rest = self.text.partition("*")
        return f"*{text}*{rest}"

    def __str__(self) -> str:
        """Return the whole message."""
        known = self.text.partition("*")[0] in NUMBERS
        number = f" ({self.number}, number from memory)" if known else ""
        detail = f": {self.detail}" if self.detail else ""
        where = f"; {self.where}" if self.where else ""
        return f"{self.message}{number}{detail}{where}"


class LoadError(Rx90Error):
    """A file whose programs cannot be executed.

    Attributes:
        faults: all faults of the file, each with its line.
    """

    def __init__(self, faults: list[str]) -> None:
        self.faults = faults
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        super().__init__(f"{faults[0]}{more}")
