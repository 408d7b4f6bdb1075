"""Operators, and what a value must be for them."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.values import FALSE, TRUE, Value, kind_of

LONGEST = 128
"""Characters of a string."""
_BITS = 0xFFFFFF
_LARGEST = 1e38

_ARITHMETIC: Final[dict[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "MOD": math.fmod,
}
_RELATIONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_LOGIC: Final[dict[str, Callable[[bool, bool], bool]]] = {
    "AND": operator.and_,
    "OR": operator.or_,
    "XOR": operator.xor,
}
_BITWISE: Final[dict[str, Callable[[int, int], int]]] = {
    "BAND": operator.and_,
    "BOR": operator.or_,
    "BXOR": operator.xor,
}


def truth(value: bool) -> float:
    """Return the real of a truth."""
    return TRUE if value else FALSE


def real(value: Value) -> float:
    """Return a value that is a real.

    Raises:
        VplusError: if it is none.
    """
    if not isinstance(value, float):
        raise VplusError("Illegal value", f"a {kind_of(value)}; accepted: a real")
    return value


def bounded(value: float) -> float:
    """Return a result that a real can hold.

    Raises:
        VplusError: if it is too large, or no number.
    """
    if not abs(value) <= _LARGEST:
        raise VplusError("Arithmetic overflow", f"{value:g}")
    return float(value)


def whole(value: Value) -> int:
    """Return a real without its fraction, as an integer."""
    return int(real(value))


def operate(sign: str, left: Value, right: Value, ignore_case: bool) -> Value:
    """Return the value of an operation."""
    if isinstance(left, str) and isinstance(right, str):
        return _of_texts(sign, left, right, ignore_case)
    first = real(left)
    second = real(right)
    if sign in _RELATIONS:
        return truth(_RELATIONS[sign](first, second))
    if sign in _LOGIC:
        return truth(_LOGIC[sign](first != 0.0, second != 0.0))
    if sign in _BITWISE:
        return float(_signed(_BITWISE[sign](int(first), int(second))))
    if sign in ("/", "MOD") and second == 0.0:
        raise VplusError("Division by zero", f"{first:g} {sign} 0")
    return bounded(_ARITHMETIC[sign](first, second))


def _of_texts(sign: str, left: str, right: str, ignore_case: bool) -> Value:
    if sign == "+":
        return left + right
    if sign not in _RELATIONS:
        raise VplusError("Illegal value", f"strings with {sign}; accepted: + and comparisons")
    if ignore_case:
        return truth(_RELATIONS[sign](left.upper(), right.upper()))
    return truth(_RELATIONS[sign](left, right))


def prefix(sign: str, value: Value) -> float:
    """Return the value of an operator before an operand."""
    number = real(value)
    if sign == "NOT":
        return truth(number == 0.0)
    if sign == "COM":
        return float(_signed(~int(number)))
    return -number if sign == "-" else number


def _signed(number: int) -> int:
    """Return an integer of 24 bits with sign."""
    number &= _BITS
    return number - _BITS - 1 if number > _BITS // 2 else number


def text_of(value: Value) -> str:
    """Return a value that is a string.

    Raises:
        VplusError: if it is none.
    """
    if not isinstance(value, str):
        raise VplusError("Illegal value", f"a {kind_of(value)}; accepted: a string")
    return value


def bounded_text(text: str) -> str:
    """Return a text that a string can hold.

    Raises:
        VplusError: if it is too long.
    """
    if len(text) > LONGEST:
        raise VplusError("String too long", f"{len(text)} characters; accepted: up to {LONGEST}")
    return text


def location(value: Value) -> Array:
    """Return a value that is a transformation.

    Raises:
        VplusError: if it is none.
    """
    if not isinstance(value, np.ndarray):
        raise VplusError("Illegal value", f"a {kind_of(value)}; accepted: a transformation")
    return value
