"""Text from outside in a message: one line without control characters, of bounded length, with its original length.

Names, values, paths and lines come from files, messages and command lines. One with a line break would forge a
line of a log, one with a bidirectional override would be displayed as another text, and a long one would fill the
screen.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from itertools import islice
from typing import Any
from unicodedata import category

LIMIT = 120
"""Characters of a quoted value, as far as the caller gives no other limit."""
LINE_LIMIT = 2000
"""Characters of a whole message."""

_ELLIPSIS = "…"
_MAX_NAMES = 20
_MAX_CANDIDATES = 1000  # among which the nearest name is looked for
_LONGEST_NAME = 100  # characters by which a misspelt name is compared
_LONGEST_INTEGER = 400  # decimal digits; Python itself refuses to write more than 4300


def quoted(value: object, limit: int = LIMIT) -> str:
    """Return the `repr` of a value in one line; a text or bytes in quotation marks.

    Args:
        value: anything; of a large object only the beginning is read.
        limit: a longer text or `repr` is shortened, and its length appended.
    """
    if isinstance(value, str | bytes | bytearray):
        text = value if isinstance(value, str) else bytes(value)
        return _shortened(text, limit, repr, "characters" if isinstance(text, str) else "bytes")
    return plain(_REPR.repr(value), limit)


def plain(text: object, limit: int = LIMIT) -> str:
    """Return a name or a path without quotation marks: in one line; a longer one is shortened, with its length."""
    return _shortened(str(text), limit, _escaped, "characters")


def listed(names: Iterable[object], most: int = _MAX_NAMES) -> str:
    """Return names with commas between them; of more than `most`, the first ones and how many others there are."""
    every = list(names)
    shown = ", ".join(plain(name) for name in every[:most])
    return f"{shown} and {len(every) - most:,} more" if len(every) > most else shown


def counted(count: int, noun: str) -> str:
    """Return how many there are of something whose plural ends in s: 1 run, 2 runs."""
    return f"{count} {noun}{'s' * (count != 1)}"


def nearest(name: str, names: Iterable[str]) -> str:
    """Return that of the accepted names which a misspelt one is most like; an empty text if none is."""
    candidates = list(islice(names, _MAX_CANDIDATES))
    return next(iter(get_close_matches(name[:_LONGEST_NAME], candidates, 1)), "")


def question(name: str) -> str:
    """Return what follows a misspelt name: whether this one is meant; nothing for an empty text."""
    return f" (did you mean {plain(name)}?)" if name else ""


def one_line(text: object) -> str:
    """Return a whole message as one line of bounded length; the results of `quoted` and `plain` stay unchanged."""
    return plain(text, LINE_LIMIT)


def aligned(
    rows: Sequence[Sequence[str]], right: Sequence[int] = (), widest: float = math.inf
) -> list[str]:
    """Return the rows of a table as lines; columns in `right` end together, cells above a width move what follows."""
    columns = zip(*(map(len, row) for row in rows), strict=True)
    widths = [max((size for size in column if size <= widest), default=0) for column in columns]
    sides = [str.rjust if k in right else str.ljust for k in range(len(widths))]
    return [
        "  ".join(side(cell, n) for side, cell, n in zip(sides, row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _shortened(text: Any, limit: int, show: Callable[[Any], str], unit: str) -> str:
    """Return what shows a text; of a long one what shows its ends, with its length."""
    if len(text) <= limit:
        return show(text)
    tail = limit // 4
    head = limit - tail
    ends = f"{show(text[:head])}{_ELLIPSIS}{show(text[len(text) - tail :])}"
    return f"{ends} ({len(text):,} {unit})"


def _escaped(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in text
    )


class _Repr(reprlib.Repr):
    """Reads no more of an object than is shown; a long integer, which Python does not print, is shown by its size."""

    def __init__(self) -> None:
        super().__init__()
        self.maxtuple = 12
        self.maxlist = 12
        self.maxdict = 8
        self.maxstring = LIMIT
        self.maxother = LIMIT

    def repr_int(self, x: int, level: int) -> str:  # noqa: ARG002 - the interface of Repr
        digits = int(abs(x).bit_length() * math.log10(2.0)) + 1
        return repr(x) if digits <= _LONGEST_INTEGER else f"an integer of some {digits:,} digits"


_REPR = _Repr()


def breaks_a_line(text: str) -> bool:
    """Return whether a text holds a control character, a line break among them."""
    return any(category(character) in ("Cc", "Zl", "Zp") for character in text)
