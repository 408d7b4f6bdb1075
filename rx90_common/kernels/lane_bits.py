"""Lanes as bit patterns: factors 2^k and signs for numbers that hold an integer k.

A double WHOLE + k holds the integer k in its lowest bits. A shift brings them to the place of another number's
exponent or sign, so that a conversion to integers, which AVX2 lacks for lanes of doubles, is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types

from rx90_common.kernels.lanes import Lanes, LanesType, Mask, Number, Operation

WHOLE = 1.5 * 2.0**52
_WHOLE_BITS = 0x4338 << 48
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD


def _bits(builder: Any, value: Any) -> Any:
    kind = value.type
    word = ir.IntType(64)
    return builder.bitcast(value, ir.VectorType(word, kind.count) if isinstance(kind, ir.VectorType) else word)


def _constant(like: Any, value: int) -> Any:
    return ir.Constant(like.type, [value] * like.type.count if isinstance(like.type, ir.VectorType) else value)


@Operation[Callable[[Number, Number], Number]].of
def times_power_of_two(_: Any, x: Any, whole: Any) -> Any:
    """Return x 2^k for whole = WHOLE + k; the result must not leave the range of normal numbers."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value, power = (_bits(builder, argument) for argument in arguments)
        moved = builder.add(value, builder.shl(power, _constant(power, 52)))
        return builder.bitcast(moved, arguments[0].type)

    return x(x, whole), emit


@Operation[Callable[[Number], Number]].of
def nearest_exponent(_: Any, x: Any) -> Any:
    """Return WHOLE + k for x = 2^k m with m from sqrt(1/2) to sqrt(2); x is a normal number > 0."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value = _bits(builder, *arguments)
        above = builder.ashr(builder.sub(value, _constant(value, _SQRT_HALF_BITS)), _constant(value, 52))
        return builder.bitcast(builder.add(above, _constant(value, _WHOLE_BITS)), arguments[0].type)

    return x(x), emit


@Operation[Callable[[Lanes], Mask]].of
def is_odd(_: Any, whole: Any) -> Any:
    """Return whether k is odd for whole = WHOLE + k."""
    lanes = isinstance(whole, LanesType)

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        bit = ir.IntType(1)
        return builder.trunc(_bits(builder, *arguments), ir.VectorType(bit, whole.padded) if lanes else bit)

    return (LanesType(whole.width, is_mask=True) if lanes else types.boolean)(whole), emit


@Operation[Callable[[Number, Number], Number]].of
def negate_in_second_half(_: Any, x: Any, whole: Any) -> Any:
    """Return -x where k modulo 4 is 2 or 3, x elsewhere, for whole = WHOLE + k."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value, turns = (_bits(builder, argument) for argument in arguments)
        sign = builder.shl(builder.lshr(turns, _constant(turns, 1)), _constant(turns, 63))
        return builder.bitcast(builder.xor(value, sign), arguments[0].type)

    return x(x, whole), emit
