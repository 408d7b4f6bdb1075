"""Strings: formats of TYPE and $ENCODE, and the functions of strings."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rx90_emulator.vplus.errors import NUMBERS, VplusError
from rx90_emulator.vplus.operators import bounded_text, real, text_of, whole
from rx90_emulator.vplus.registry import MANY, function, functions
from rx90_emulator.vplus.syntax import Expression, Format, Reference
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.values import Value

_LARGEST_WIDTH = 128
_FORMAT = re.compile(r"([A-Z])(\d*)(?:\.(\d+))?$")
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d{1,2})?)", re.IGNORECASE | re.ASCII)
_BASE_NUMBER = re.compile(r"\s*\^(?:B([01]+)|O([0-7]+)|H([0-9A-F]+))", re.IGNORECASE | re.ASCII)


def written(items: Iterable[Value | Format], format_persists: bool) -> tuple[str, bool]:
    """Return the text of the items of TYPE or $ENCODE, and whether a line ends behind it."""
    text = ""
    ends = True
    style = Format("D")
    for item in items:
        if not isinstance(item, Format):
            text += _shown(item, style)
            if not format_persists:
                style = Format("D")
        elif item.text == "S":
            ends = False
        elif item.text[0] in "XC":
            text += (" " if item.text[0] == "X" else "\n") * min(int(item.text[1:] or 1), _LARGEST_WIDTH)
        else:
            style = item
    return text, ends


def _shown(value: Value, style: Format) -> str:
    if isinstance(value, str):
        return value
    number = real(value)
    match = _FORMAT.match(style.text)
    kind = match[1] if match else "?"
    width = int(match[2] or 0) if match else 0
    places = int(match[3] or 0) if match else 0
    if kind not in "DEFGHIO" or width > _LARGEST_WIDTH or places > _LARGEST_WIDTH:
        raise VplusError(
            "Illegal value", f"format /{style.text}; accepted: /D /Ew.d /Fw.d /Gw.d /Hn /In /On /Xn /Cn /S"
        )
    if kind == "D":
        return f" {number + 0.0:.7g}"
    if kind in "EFG":
        return _fitting(f"{_without_sign_of_zero(number, places):{width}.{places}{kind}}", width)
    code = {"I": "d", "H": "X", "O": "o"}[kind]
    return _fitting(f"{round(number):{width}{code}}", width)


def _without_sign_of_zero(number: float, places: int) -> float:
    """Return 0 for a number that rounds to it: its sign would show as -0.0."""
    return 0.0 if abs(number) < 0.5 * 10.0**-places else number


def _fitting(shown: str, width: int) -> str:
    return "*" * width if width and len(shown) > width else shown


@function("$ENCODE", 0, MANY)
def encoded(task: Task, *items: Value | Format) -> str:
    """Return items as TYPE would show them."""
    return bounded_text(written(items, task.readings.format_persists)[0])


@function("ASC", 1, 2)
def code_of(_: Task, text: Value, place: Value = 1.0) -> float:
    """Return the code of a character."""
    string = text_of(text)
    number = whole(place)
    return float(ord(string[number - 1])) if 1 <= number <= len(string) else -1.0


@function("$CHR", 1)
def character(_: Task, code: Value) -> str:
    """Return the character of a code."""
    if not 0 <= whole(code) <= 255:
        raise VplusError("Illegal value", f"$CHR({real(code):g}); accepted: 0 to 255")
    return chr(whole(code))


@function("POS", 2, 3)
def place_of(_: Task, text: Value, part: Value, start: Value = 1.0) -> float:
    """Return where a string stands in another, counted from 1; 0: nowhere."""
    return float(text_of(text).find(text_of(part), max(whole(start) - 1, 0)) + 1)


@function("VAL", 1)
def number_of(_: Task, text: Value) -> float:
    """Return the number that a string begins with, 0 if there is none."""
    based = _BASE_NUMBER.match(text_of(text))
    if based is not None:
        return float(int(based[based.lastindex or 1], (2, 8, 16)[(based.lastindex or 1) - 1]))
    match = _NUMBER.match(text_of(text))
    return float(match[1]) if match else 0.0


@function("$ERROR", 1)
def error_text(_: Task, number: Value) -> str:
    """Return the text of an error."""
    texts = [text for text, code in NUMBERS.items() if code == whole(number)]
    return f"*{texts[0]}*" if texts else f"*Unknown error code* {whole(number)}"


@function("$TIME", 0, 2)
def time_text(task: Task, *_: Value) -> str:
    """Return the time since the run began, as the time of a day."""
    seconds = int(task.cell.time)
    return f"01-JAN-00 {seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def _middle(text: str, first: int, count: int) -> str:
    return text[max(first - 1, 0) :][: max(count, 0)]


def _order(left: str, right: str) -> float:
    return float((left > right) - (left < right))


functions(
    {
        "LEN": (1, lambda _, text: float(len(text_of(text)))),
        "$MID": (3, lambda _, text, first, count: _middle(text_of(text), whole(first), whole(count))),
        "STRDIF": (2, lambda _, left, right: _order(text_of(left), text_of(right))),
        "$TRUNCATE": (1, lambda _, text: text_of(text).partition("\0")[0]),
    }
)


@function("$DECODE", 2, 3, trees=True)
def decoded(task: Task, source: Expression, delimiters: Expression, mode: Expression | None = None) -> str:
    """Take characters off the front of a string: up to a delimiter, or with mode 1 the leading delimiters."""
    if not isinstance(source, Reference):
        raise VplusError("Illegal value", "$DECODE of an expression; accepted: a variable")
    text = text_of(task.value(source))
    marks = text_of(task.value(delimiters))
    wants_marks = mode is not None and real(task.value(mode)) > 0.0
    count = 0
    while count < len(text) and (text[count] in marks) == wants_marks:
        count += 1
    task.cell_of(source).store(source.name, text[count:])
    return text[:count]
