"""What stops a motion or a program, in the words of V+.

Texts are better known than their numbers: both are from memory of the manuals, and every message says so of its number.
"""

from __future__ import annotations

from rx90_common.base.errors import FailureError

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
