"""Exponential, sine and cosine for lanes and floats; the C library has them for one number at a time only.

Reduction to a small interval after Cody and Waite (1980), then a polynomial. Errors stay below 1.2 ulp for exp, and
below 1.6 ulp for sine and cosine of up to a thousand radians. docs/kernels.md explains the method, and
tools/elementary_coefficients.py computes the constants.
"""

from __future__ import annotations

from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lane_bits import WHOLE, is_odd, negate_in_second_half, times_power_of_two
from rx90_common.kernels.lanes import Number, absolute, any_lane, fma, lane, replace_lane, select, width_of

_LOG2_E = 1.4426950408889634
_TWO_BY_PI = 0.6366197723675814
# ln 2 and pi/2 in parts. Parts of 32 bits leave room for a factor of 20 bits: the products are exact.
_LN2 = (0.6931471803691238, 1.9082149292705877e-10)
_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487111665e-21)
_LEAST_EXPONENT = -708.0  # exp below this is smaller than every normal number

# exp(r) = 1 + r + r^2 (E0 + E1 r + ...), sin(r) = r + r^3 (S0 + S1 r^2 + ...), cos(r) = 1 - r^2/2 + r^4 (...)
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


@inlined
def exponential(x: Number) -> Number:
    """Return exp(x) for x up to 708; below -708 it is 0."""
    floored = select(x < _LEAST_EXPONENT, _LEAST_EXPONENT, x)
    whole = fma(floored, _LOG2_E, WHOLE)
    k = whole - WHOLE
    r = fma(k, -_LN2[1], fma(k, -_LN2[0], floored))
    square = r * r
    low = fma(square, fma(r, _E[3], _E[2]), fma(r, _E[1], _E[0]))
    high = fma(square, fma(r, _E[7], _E[6]), fma(r, _E[5], _E[4]))
    fourth = square * square
    rest = fma(fourth, fma(fourth, fma(r, _E[9], _E[8]), high), low)
    return select(x < _LEAST_EXPONENT, 0.0, times_power_of_two(1.0 + fma(square, rest, r), whole))


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
    """Return base^exponent for base >= 0; exponents 1 and 2, exact and in all lanes at once, are the fast ones."""
    result = select(exponent == 2.0, base * base, base)
    if any_lane(absolute((exponent - 1.0) * (exponent - 2.0)) > 0.0):
        for i in range(width_of(base)):
            # The others keep their bits whatever stands beside them.
            if absolute((lane(exponent, i) - 1.0) * (lane(exponent, i) - 2.0)) > 0.0:
                result = replace_lane(result, i, lane(base, i) ** lane(exponent, i))
    return result
