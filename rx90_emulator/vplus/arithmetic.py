"""Functions of reals."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.operators import bounded, real, truth
from rx90_emulator.vplus.registry import MANY, function, functions
from rx90_emulator.vplus.task import Task
from rx90_emulator.vplus.values import Value

_OF_ONE: Final[dict[str, Callable[[float], float]]] = {
    "SIN": lambda angle: math.sin(math.radians(angle)),
    "COS": lambda angle: math.cos(math.radians(angle)),
    "TAN": lambda angle: math.tan(math.radians(angle)),
    "SQR": lambda number: number * number,
    "ABS": abs,
    "INT": math.trunc,
    "FRACT": lambda number: math.fmod(number, 1.0),
    "SIGN": lambda number: 1.0 if number >= 0.0 else -1.0,
}


def _enter(name: str, value: Callable[[float], float]) -> None:
    @function(name, 1)
    def of_one(_: Task, number: Value) -> float:
        return bounded(value(real(number)))


for _name, _value in _OF_ONE.items():
    _enter(_name, _value)


@function("SQRT", 1)
def square_root(_: Task, number: Value) -> float:
    """Return the square root."""
    if real(number) < 0.0:
        raise VplusError("Illegal value", f"SQRT({real(number):g})")
    return math.sqrt(real(number))


@function("MIN", 1, MANY)
def least(_: Task, *numbers: Value) -> float:
    """Return the least of numbers."""
    return min(real(number) for number in numbers)


@function("MAX", 1, MANY)
def largest(_: Task, *numbers: Value) -> float:
    """Return the largest of numbers."""
    return max(real(number) for number in numbers)


functions(
    {
        "ATAN2": (2, lambda _, y, x: math.degrees(math.atan2(real(y), real(x)))),
        "OUTSIDE": (3, lambda _, low, number, high: truth(not real(low) <= real(number) <= real(high))),
        "RANDOM": (0, lambda task: task.lot.random()),
    }
)
