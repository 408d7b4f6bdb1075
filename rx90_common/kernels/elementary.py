"""Exponential, sine, cosine, power, arc tangent and random numbers: the same bits on every machine.

All but the arc tangent work on lanes and floats. Reduction to a small interval after Cody and Waite (1980), then a
polynomial. Errors stay below 1.2 ulp for exp, below 1.6 ulp for sine and cosine of up to a thousand radians, below
2 ulp for the arc tangent and for powers up to the fourth. docs/explanation/kernels.md explains the method, and
tools/elementary_coefficients.py computes the constants.

Random numbers are those of SplitMix64 (Steele, Lea and Flood, Fast splittable pseudorandom number generators, 2014): a
sequence is a counter that grows by GOLDEN.

Compiled code calls these functions; the last ones here serve Python, with numbers and arrays, before it runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import (
    Lanes,
    LanesType,
    Mask,
    Number,
    Operation,
    absolute,
    any_lane,
    fma,
    select,
)

# A double WHOLE + k holds the integer k in its lowest bits. A shift brings them to the place of another number's
# exponent or sign, so that a conversion to integers, which AVX2 lacks for lanes of doubles, is not needed.
WHOLE = 1.5 * 2.0**52
_WHOLE_BITS = 0x4338 << 48
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD


def _bits(builder: Any, value: Any) -> Any:
    kind = value.type
    word = ir.IntType(64)
    return builder.bitcast(
        value, ir.VectorType(word, kind.count) if isinstance(kind, ir.VectorType) else word
    )


def _constant(like: Any, value: int) -> Any:
    return ir.Constant(
        like.type, [value] * like.type.count if isinstance(like.type, ir.VectorType) else value
    )


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
        above = builder.ashr(
            builder.sub(value, _constant(value, _SQRT_HALF_BITS)), _constant(value, 52)
        )
        return builder.bitcast(builder.add(above, _constant(value, _WHOLE_BITS)), arguments[0].type)

    return x(x), emit


@Operation[Callable[[Lanes], Mask]].of
def is_odd(_: Any, whole: Any) -> Any:
    """Return whether k is odd for whole = WHOLE + k."""
    lanes = isinstance(whole, LanesType)

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        bit = ir.IntType(1)
        return builder.trunc(
            _bits(builder, *arguments), ir.VectorType(bit, whole.padded) if lanes else bit
        )

    return (LanesType(whole.width, is_mask=True) if lanes else types.boolean)(whole), emit


@Operation[Callable[[Number, Number], Number]].of
def negate_in_second_half(_: Any, x: Any, whole: Any) -> Any:
    """Return -x where k modulo 4 is 2 or 3, x elsewhere, for whole = WHOLE + k."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value, turns = (_bits(builder, argument) for argument in arguments)
        sign = builder.shl(builder.lshr(turns, _constant(turns, 1)), _constant(turns, 63))
        return builder.bitcast(builder.xor(value, sign), arguments[0].type)

    return x(x, whole), emit


_LOG2_E = 1.4426950408889634
_TWO_BY_PI = 0.6366197723675814
# ln 2 and pi/2 in parts. Parts of 32 bits leave room for a factor of 20 bits: the products are exact.
_LN2 = (0.6931471803691238, 1.9082149292705877e-10)
_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487111665e-21)
_MIN_EXPONENT = -708.0  # exp below this is smaller than every normal number
_MAX_EXPONENT = 709.0  # exp beyond this comes near the largest number
_MIN_NORMAL = 2.0**-1022
# For a = 0, atan(1/2) and atan(1): a, pi/2 - a, pi - a and pi/2 + a, each as a double and its rounding error.
_ARCS = (
    (0.0, 0.0),
    (1.5707963267948966, 6.123233995736765e-17),
    (3.141592653589793, 1.224646799147353e-16),
    (1.5707963267948966, 6.123233995736765e-17),
    (0.4636476090008061, 2.2698777452961684e-17),
    (1.1071487177940904, 9.40447137356638e-17),
    (2.677945044588987, 1.5527705369303144e-16),
    (2.0344439357957027, 2.8419966179071514e-17),
    (0.7853981633974483, 3.0616169978683824e-17),
    (0.7853981633974483, 3.0616169978683824e-17),
    (2.356194490192345, 9.184850993605148e-17),
    (2.356194490192345, 9.184850993605148e-17),
)

# exp(r) = 1 + r + r^2 (E0 + E1 r + ...), sin(r) = r + r^3 (S0 + S1 r^2 + ...), cos(r) = 1 - r^2/2 + r^4 (...),
# ln((1 + s) / (1 - s)) = 2 s + s^3 (L0 + L1 s^2 + ...), atan(u) = u + u^3 (A0 + A1 u^2 + ...)
_E = (
    0.5,
    0.16666666666666669,
    0.041666666666623824,
    0.008333333333330039,
    0.0013888888917367081,
    0.00019841269863171557,
    2.4801521057868204e-05,
    2.7557268276905696e-06,
    2.7620201591031547e-07,
    2.5100472505694996e-08,
)
_S = (
    -0.16666666666666666,
    0.008333333333330925,
    -0.00019841269836722418,
    2.755731608381636e-06,
    -2.5051127944014188e-08,
    1.5917848524808262e-10,
)
_C = (
    0.041666666666666664,
    -0.0013888888888887382,
    2.480158729874307e-05,
    -2.7557317260008837e-07,
    2.0876143827993133e-09,
    -1.1382456778061306e-11,
)
_L = (
    0.6666666666666666,
    0.4000000000000089,
    0.28571428570795937,
    0.2222222239345263,
    0.181817954545265,
    0.15386249788196105,
    0.1326850331279476,
    0.13089445145246312,
)
_A = (
    -0.3333333333333333,
    0.19999999999999493,
    -0.14285714285475526,
    0.11111111067825083,
    -0.09090905152247004,
    0.07692105803256599,
    -0.06660558733199207,
    0.0577364583557161,
    -0.04195683344795413,
)


@inlined
def exponential(x: Number) -> Number:
    """Return exp(x) for x up to 708; below -708 it is 0."""
    floored = select(x < _MIN_EXPONENT, _MIN_EXPONENT, x)
    whole = fma(floored, _LOG2_E, WHOLE)
    k = whole - WHOLE
    r = fma(k, -_LN2[1], fma(k, -_LN2[0], floored))
    return select(x < _MIN_EXPONENT, 0.0, times_power_of_two(1.0 + _grown(r), whole))


@inlined
def _grown(r: Number) -> Number:
    """Return exp(r) - 1 for |r| up to ln 2 / 2."""
    square = r * r
    low = fma(square, fma(r, _E[3], _E[2]), fma(r, _E[1], _E[0]))
    high = fma(square, fma(r, _E[7], _E[6]), fma(r, _E[5], _E[4]))
    fourth = square * square
    return fma(square, fma(fourth, fma(fourth, fma(r, _E[9], _E[8]), high), low), r)


@inlined
def exponential_less_one(x: Number) -> Number:
    """Return exp(x) - 1 for x up to 708, without cancellation next to 0."""
    return select(absolute(x) < 0.34, _grown(x), exponential(x) - 1.0)


@inlined
def sine_cosine(x: Number) -> tuple[Number, Number]:
    """Return sin(x) and cos(x) for angles of up to a million radians."""
    whole = fma(x, _TWO_BY_PI, WHOLE)
    k = whole - WHOLE
    r = fma(k, -_HALF_PI[2], fma(k, -_HALF_PI[1], fma(k, -_HALF_PI[0], x)))
    square = r * r
    fourth = square * square
    s = fma(fourth, fma(square, _S[5], _S[4]), fma(square, _S[3], _S[2]))
    s = fma(r * square, fma(fourth, s, fma(square, _S[1], _S[0])), r)
    c = fma(fourth, fma(square, _C[5], _C[4]), fma(square, _C[3], _C[2]))
    c = fma(fourth, fma(fourth, c, fma(square, _C[1], _C[0])), fma(square, -0.5, 1.0))
    swap = is_odd(whole)
    return (
        negate_in_second_half(select(swap, c, s), whole),
        negate_in_second_half(select(swap, s, c), whole + 1.0),
    )


@inlined
def power(base: Number, exponent: Number) -> Number:
    """Return base^exponent for base >= 0 and exponent > 0; 1 and 2 are exact, and the fast ones.

    A base below the smallest normal number counts as 0, and beyond exp(709) the result is infinite.
    """
    result = select(exponent == 2.0, base * base, base)
    other = absolute((exponent - 1.0) * (exponent - 2.0)) > 0.0
    if any_lane(other):
        result = select(other, _general_power(base, exponent), result)
    return result


@inlined
def signed_power(x: Number, exponent: Number) -> Number:
    """Return |x|^exponent with the sign of x, for exponent > 0; exponent 1 gives the bits of x."""
    other = absolute(exponent - 1.0) > 0.0
    result = select(other, x, x)  # a lane for each exponent, also of a single x
    if any_lane(other):
        size = power(absolute(x), exponent)
        result = select(other, select(x < 0.0, -size, size), x)
    return result


@inlined
def _general_power(base: Number, exponent: Number) -> Number:
    """Return exp(exponent ln(base)); the logarithm is the sum of two numbers, so that its rounding does not count."""
    whole = nearest_exponent(base)
    k = whole - WHOLE
    m = times_power_of_two(base, WHOLE - k)  # from sqrt(1/2) to sqrt(2)
    # ln(m) = ln((1 + s) / (1 - s)), with what is lost of s in the division.
    sum_ = m + 1.0
    s = (m - 1.0) / sum_
    rounding = (fma(-s, sum_, m - 1.0) - s * (m - (sum_ - 1.0))) / sum_
    square = s * s
    fourth = square * square
    low = fma(fourth, fma(square, _L[3], _L[2]), fma(square, _L[1], _L[0]))
    high = fma(fourth, fma(square, _L[7], _L[6]), fma(square, _L[5], _L[4]))
    tail = fma(s * square, fma(fourth * fourth, high, low), 2.0 * rounding)
    leading = k * _LN2[0]
    most = leading + 2.0 * s
    rest = (2.0 * s - (most - leading)) + fma(k, _LN2[1], tail)
    logarithm = most + rest
    rest = rest - (logarithm - most)
    product = exponent * logarithm
    rest = fma(exponent, rest, fma(exponent, logarithm, -product))
    grown = exponential(select(product > _MAX_EXPONENT, _MAX_EXPONENT, product))
    result = select(product > _MAX_EXPONENT, math.inf, fma(grown, rest, grown))
    # The exponent is that of normal numbers alone: smaller bases give 0, NaN gives NaN.
    return select(base >= _MIN_NORMAL, result, base * 0.0)


@inlined
def arctangent(y: float, x: float) -> float:
    """Return the angle of the point (x, y), rad, from -pi to pi; 0 for the origin."""
    width = abs(x)
    height = abs(y)
    steep = height > width
    low, high = (width, height) if steep else (height, width)
    # tan(a - b) = (tan a - tan b) / (1 + tan a tan b), with tan b the nearest of 0, 1/2 and 1.
    if low <= 0.236 * high:
        u = low / high if high > 0.0 else 0.0
        place = 0
    elif low <= 0.72 * high:
        u = (2.0 * low - high) / (2.0 * high + low)
        place = 4
    else:
        u = (low - high) / (low + high)
        place = 8
    square = u * u
    fourth = square * square
    tail = fma(fourth, fma(square, _A[3], _A[2]), fma(square, _A[1], _A[0]))
    end = fma(fourth, fma(fourth, _A[8], fma(square, _A[7], _A[6])), fma(square, _A[5], _A[4]))
    angle = fma(u * square, fma(fourth * fourth, end, tail), u)
    behind = x < 0.0
    if steep != behind:
        angle = -angle
    leading, rest = _ARCS[place + (2 if behind else 0) + (1 if steep else 0)]
    return math.copysign(leading + (rest + angle), y)


GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""What a counter grows by from one word to the next."""
# The shifts and factors of SplitMix64's output function.
_SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
_FACTORS = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
# A word holds four uniform numbers of 16 bits; mean and standard deviation of their sum.
_BITS = np.uint64(16)
_LOW_BITS = np.uint64(0xFFFF)
_MEAN = 2.0 * (2**16 - 1)
_DEVIATION = math.sqrt(4.0 * (2.0**32 - 1.0) / 12.0)


@inlined
def mixed(word: Any) -> Any:
    """Return the output of SplitMix64 for its counter, a np.uint64."""
    word = (word ^ (word >> _SHIFTS[0])) * _FACTORS[0]
    word = (word ^ (word >> _SHIFTS[1])) * _FACTORS[1]
    return word ^ (word >> _SHIFTS[2])


@inlined
def nearly_normal(word: Any) -> float:
    """Return a random number of mean 0 and variance 1, within 3.5, from a word: the sum of its four uniform ones."""
    total = 0.0
    for _ in range(4):
        total += float(word & _LOW_BITS)
        word >>= _BITS
    return (total - _MEAN) / _DEVIATION


def sines_cosines(angle: ArrayLike) -> tuple[Array, Array]:
    """Return sine and cosine of angles, rad, of any shape."""
    angles = np.array(angle, dtype=np.float64)
    sine = np.empty(angles.size)
    cosine = np.empty(angles.size)
    _sines_cosines(angles.ravel(), sine, cosine)
    return sine.reshape(angles.shape), cosine.reshape(angles.shape)


def angles_of(y: ArrayLike, x: ArrayLike) -> Array:
    """Return the angles of points, rad, from -pi to pi; the shapes are broadcast."""
    return _of_pairs(_angles, y, x)


def powers(base: ArrayLike, exponent: ArrayLike) -> Array:
    """Return base^exponent for bases >= 0 and exponents > 0; the shapes are broadcast."""
    return _of_pairs(_powers, base, exponent)


def _of_pairs(compute: Callable[[Array, Array, Array], None], *given: ArrayLike) -> Array:
    pairs = np.stack(np.broadcast_arrays(*(np.asarray(one, dtype=np.float64) for one in given)))
    result = np.empty(pairs[0].size)
    compute(pairs[0].ravel(), pairs[1].ravel(), result)
    return result.reshape(pairs[0].shape)


@kernel
def exponential_of(x: float) -> float:
    """Return exp(x) for x up to 708; below -708 it is 0."""
    return exponential(x)


@kernel
def exponential_less_one_of(x: float) -> float:
    """Return exp(x) - 1 for x up to 708, without cancellation next to 0."""
    return exponential_less_one(x)


@kernel
def _sines_cosines(angle: Array, sine: Array, cosine: Array) -> None:
    for i in range(angle.size):
        sine[i], cosine[i] = sine_cosine(angle[i])


@kernel
def _powers(base: Array, exponent: Array, result: Array) -> None:
    for i in range(base.size):
        result[i] = power(base[i], exponent[i])


@kernel
def _angles(y: Array, x: Array, angle: Array) -> None:
    for i in range(y.size):
        angle[i] = arctangent(y[i], x[i])
