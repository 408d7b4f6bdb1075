"""The table of functions and operators: the kinds of their arguments, and their values."""

from __future__ import annotations

import math
import operator
import re
import time
from collections.abc import Callable, Iterable
from functools import partial
from itertools import takewhile
from typing import Any, Final

import numpy as np
from pinocchio import SE3

from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.errors import NUMBERS, VplusError
from rx90_emulator.cabinet.locations import X, Y, Z, frame, six, trans, turned
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.tree import Tree, entries
from rx90_emulator.vplus.values import Format, Value, Variable

_LARGEST_WIDTH = 128
_SAME = 1e-3  # mm, and 1e-3 of a turn's matrix
_FORMAT = re.compile(r"([DEFGHIO])(\d{0,3})(?:\.(\d{1,2}))?$")
_CODES = {"H": "X", "I": "d", "O": "o"}
_NUMBER = re.compile(
    r"\s*(?:\^B([01]+)|\^O([0-7]+)|\^H([0-9A-F]+)|([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?))"
)
_BASES = (2, 8, 16)


# Strings.


def written(task: Task, items: Iterable[Value]) -> tuple[str, bool]:
    """Return the text of the items of TYPE or $ENCODE, and whether a line ends behind it."""
    text = ""
    ends = True
    style = "D"
    for item in items:
        if not isinstance(item, Format):
            text += item if isinstance(item, str) else _shown(item, style)
            style = style if task.readings.format_persists else "D"
        elif item.text == "S":
            ends = False
        elif item.text[0] in "XC":
            text += {"X": " ", "C": "\n"}[item.text[0]] * min(
                int(item.text[1:] or 1), _LARGEST_WIDTH
            )
        else:
            style = item.text
    return text, ends


def _shown(number: Value, style: str) -> str:
    match = _FORMAT.match(style)
    if match is None or not isinstance(number, float):
        formats = "/D /Ew.d /Fw.d /Gw.d /Hn /In /On /Xn /Cn /S"
        raise VplusError("Illegal value", f"format /{style} of a number; accepted: {formats}")
    if match[1] == "D":
        return f" {number + 0.0:.7g}"
    width = int(match[2] or 0)
    if match[1] in _CODES:
        shown = f"{round(number):{width}{_CODES[match[1]]}}"
    else:
        places = int(match[3] or 0)
        seen = round(number, places) if match[1] == "F" else number
        shown = f"{seen + 0.0:{width}.{places}{match[1]}}"  # without the sign of zero
    return "*" * width if width and len(shown) > width else shown


def number_of(text: str) -> float:
    """Return the number that a string begins with, 0 if there is none."""
    match = _NUMBER.match(text.upper())
    if match is None:
        return 0.0
    kind = match.lastindex or 1
    if kind > len(_BASES):
        return float(match[kind])
    try:
        return float(int(match[kind], _BASES[kind - 1]))
    except OverflowError:
        return math.inf


def _decoded(source: Variable, delimiters: str, mode: float | None = None) -> str:
    """Take characters off the front of a string: up to a delimiter, or with mode 1 the leading delimiters."""
    text = source.value
    if not isinstance(text, str):
        raise VplusError("Undefined value", source.name)
    wants_marks = (mode or 0.0) > 0.0
    taken = "".join(takewhile(lambda mark: (mark in delimiters) == wants_marks, text))
    source.store(text[len(taken) :])
    return taken


def _error_text(number: int) -> str:
    texts = [text for text, code in NUMBERS.items() if code == number]
    return f"*{texts[0] if texts else 'Unknown error code'}*"


# Locations, signals, the state of the program.


def _bit_sum(truths: Iterable[bool]) -> int:
    return sum(1 << bit for bit, truth in enumerate(truths) if truth)


def _in_range(task: Task, target: SE3 | Joints) -> int:
    """Return 0 for a location that the arm reaches; else bit n for joint n, or bit 14 where no joints would do."""
    try:
        q = task.arm.angles(target) if isinstance(target, Joints) else task.solve(target)
    except VplusError:
        return 1 << 13
    return sum(1 << joint for joint in task.arm.outside(q))


def _last(task: Task, array: Tree) -> int:
    """Return the highest index in use of an array, -1 for one without elements."""
    variables = task.table(array).items()
    return max(
        (index[-1] for index, variable in variables if index and variable.value is not None),
        default=-1,
    )


def _speed(task: Task, kind: int) -> float:
    """Return a speed, percent: 1 of the monitor, 2 of all motions, 3 of the next one."""
    if kind == 1:
        return task.queue.monitor
    return (task.always if kind == 2 else task.next)["SPEED"]


def _of_values(function: Callable[..., Value]) -> Callable[..., Value]:
    """Return a function that does not need the task as one that gets it."""
    return lambda _, *values: function(*values)


_VALUES: Final[dict[str, Any]] = {
    "+  plain plain": operator.add,
    "-  real real": operator.sub,
    "*  real real": operator.mul,
    "/  real real": operator.truediv,
    "MOD  real real": lambda left, right: math.fmod(left, right) if right else left / right,
    "AND  truth truth": operator.and_,
    "OR  truth truth": operator.or_,
    "XOR  truth truth": operator.xor,
    "BAND  bits bits": operator.and_,
    "BOR  bits bits": operator.or_,
    "BXOR  bits bits": operator.xor,
    "==  folded folded": operator.eq,
    "<>  folded folded": operator.ne,
    "<  folded folded": operator.lt,
    "<=  folded folded": operator.le,
    ">  folded folded": operator.gt,
    ">=  folded folded": operator.ge,
    "NOT  truth": operator.not_,
    "COM  bits": operator.invert,
    ":  place place": operator.mul,
    "TRUE ON": lambda: True,
    "FALSE OFF": lambda: False,
    "PI": lambda: math.pi,
    "SIN  degrees": math.sin,
    "COS  degrees": math.cos,
    "TAN  degrees": math.tan,
    "ATAN2  real real": lambda y, x: math.degrees(math.atan2(y, x)),
    "SQR  real": lambda number: number * number,
    "SQRT  real": math.sqrt,
    "ABS  real": abs,
    "INT  real": math.trunc,
    "FRACT  real": lambda number: math.fmod(number, 1.0),
    "SIGN  real": lambda number: 1 if number >= 0.0 else -1,
    "MIN  real real*": lambda *numbers: min(numbers),
    "MAX  real real*": lambda *numbers: max(numbers),
    "OUTSIDE  real real real": lambda low, number, high: not low <= number <= high,
    "LEN  text": len,
    "ASC  text integer?": lambda text, place=1: (
        ord(text[place - 1]) if 1 <= place <= len(text) else -1
    ),
    "POS  text text integer?": lambda text, part, start=1: text.find(part, max(start - 1, 0)) + 1,
    "VAL  text": number_of,
    "STRDIF  text text": lambda left, right: (left > right) - (left < right),
    "$CHR  integer": lambda code: bytes([code]).decode("latin-1"),
    "$MID  text integer integer": lambda text, first, count: text[max(first - 1, 0) :][
        : max(count, 0)
    ],
    "$TRUNCATE  text": lambda text: text.partition("\0")[0],
    "$DECODE  variable text real?": _decoded,
    "$ERROR  integer": _error_text,
    "TRANS  real? real? real? real? real? real?": trans,
    "#PPOINT  real? real? real? real? real? real?": lambda *joints: Joints(six(joints)),
    "INVERSE  place": SE3.inverse,
    "SHIFT  place real? real? real?": lambda place, *by: trans(*by) * place,
    "SCALE  place real": lambda place, factor: SE3(place.rotation, factor * place.translation),
    "FRAME  place place place place": frame,
    "RX  real": partial(turned, X),
    "RY  real": partial(turned, Y),
    "RZ  real": partial(turned, Z),
    "DX  place": lambda place: place.translation[0].item(),
    "DY  place": lambda place: place.translation[1].item(),
    "DZ  place": lambda place: place.translation[2].item(),
    "DISTANCE  place place": lambda left, right: math.dist(left.translation, right.translation),
    "IDENTICAL  place place": lambda left, right: (
        np.abs(left.homogeneous - right.homogeneous).max() < _SAME
    ),
    "NULL": SE3.Identity,
}
_STATE: Final[dict[str, Any]] = {
    "RANDOM": lambda task: task.lot.random(),
    "TOOL": lambda task: task.tool,
    "BASE": lambda task: task.base,
    "HERE": lambda task: task.tool_at(task.cell.drive.position()),
    "DEST": lambda task: task.tool_at(task.queue.destination),
    "#PHERE": lambda task: task.arm.joints(task.cell.drive.position()),
    "#PDEST": lambda task: task.arm.joints(task.queue.destination),
    "TIME": lambda task: task.cell.time,
    "$TIME  any*": lambda task, *_: time.strftime("%d-%b-%y %H:%M:%S", time.gmtime(task.cell.time)),
    "$ENCODE  any*": lambda task, *items: written(task, items)[0],
    "INRANGE  location": _in_range,
    "CONFIG  any?": lambda task, _=None: _bit_sum(
        task.arm.configuration(task.cell.drive.position())
    ),
    "DEFINED  tree": lambda task, variable: task.variable(variable).value is not None,
    "LAST  tree": _last,
    "SIG  integer integer*": lambda task, *signals: all(map(task.cell.is_on, signals)),
    "BITS  integer integer?": lambda task, first, count=1: _bit_sum(
        task.cell.is_on(first + bit) for bit in range(min(count, 24))
    ),
    "TIMER  integer": lambda task, number: task.cell.time - task.timers.get(number, 0.0),
    "SWITCH  name": lambda task, name: name in task.cell.switches,
    "SPEED  integer": _speed,
    "ACCEL  integer": lambda task, kind: task.always["UP" if kind == 1 else "DOWN"],
    "DURATION  integer?": lambda task, _=1: task.always["DURATION"],
    "ERROR  integer": lambda task, _: task.error,
    "IOSTAT  integer": lambda *_: 1,
}
FUNCTIONS = entries({words: _of_values(action) for words, action in _VALUES.items()} | _STATE)
