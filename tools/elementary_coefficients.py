"""Compute the constants of rx90_common/kernels/elementary.py and print them as they stand there.

    python3 tools/elementary_coefficients.py

Below them stands the largest relative error of each polynomial with its rounded coefficients. All arithmetic is
decimal with 60 digits, and each result is rounded to a double once. Only the standard library is needed.

Each function is its first terms plus a power of r times a remainder. The remainder is interpolated at the zeros
of a Chebyshev polynomial, which comes close to the polynomial of least error (Trefethen 2013, Approximation
Theory and Approximation Practice, chapters 2 to 4, 10). The first coefficient is then replaced by the remainder's
value at 0, so that the leading terms of the Taylor series are right to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal, getcontext
from math import factorial
from typing import NamedTuple

DIGITS = 60
TINY = Decimal(10) ** -DIGITS
WIDEST_TANGENT = Decimal("0.2381")
"""The largest reduced argument of the arc tangent: its intervals end at 0.236 and 0.72."""
MARGIN = Decimal("1.001")
"""Rounding may leave the reduced argument a little beyond the interval; the polynomials hold for this much more."""


class Remainder(NamedTuple):
    """What is left of a function behind its first terms, as a function of x.

    Attributes:
        name: of the coefficients.
        count: how many coefficients there are.
        taylor: the coefficient of x^k in the Taylor series.
        interval: the range of x.
        error: relative error of the function at x for a wrong value of the remainder, per unit.
    """

    name: str
    count: int
    taylor: Callable[[int], Decimal]
    interval: tuple[Decimal, Decimal]
    error: Callable[[Decimal], Decimal]


def remainders() -> list[Remainder]:
    """Return the remainders of exp, sine, cosine, the logarithm and the arc tangent.

    exp(r) = 1 + r + r^2 E(r), sin(r) = r + r^3 S(r^2), cos(r) = 1 - r^2/2 + r^4 C(r^2),
    ln((1 + s) / (1 - s)) = 2 s + s^3 L(s^2), atan(u) = u + u^3 A(u^2).
    """
    half_ln2, quarter_pi = MARGIN * Decimal(2).ln() / 2, MARGIN * pi() / 4
    squares = (Decimal(0), quarter_pi**2)
    ratio = Decimal(2).sqrt()
    logarithms = (Decimal(0), (MARGIN * (ratio - 1) / (ratio + 1)) ** 2)
    tangents = (Decimal(0), (MARGIN * WIDEST_TANGENT) ** 2)

    def sine(k: int) -> Decimal:
        return Decimal((-1) ** (k + 1)) / factorial(2 * k + 3)

    def cosine(k: int) -> Decimal:
        return Decimal((-1) ** k) / factorial(2 * k + 4)

    def logarithm(k: int) -> Decimal:
        return Decimal(2) / (2 * k + 3)

    def arc(k: int) -> Decimal:
        return Decimal((-1) ** (k + 1)) / (2 * k + 3)

    return [
        Remainder(
            "_E",
            10,
            lambda k: Decimal(1) / factorial(k + 2),
            (-half_ln2, half_ln2),
            lambda r: r * r / r.exp(),
        ),
        Remainder("_S", 6, sine, squares, lambda x: x / (1 + x * series(sine, x))),
        Remainder(
            "_C", 6, cosine, squares, lambda x: x * x / (1 - x / 2 + x * x * series(cosine, x))
        ),
        Remainder("_L", 8, logarithm, logarithms, lambda x: x / (2 + x * series(logarithm, x))),
        Remainder("_A", 9, arc, tangents, lambda x: x / (1 + x * series(arc, x))),
    ]


def series(coefficient: Callable[[int], Decimal], x: Decimal) -> Decimal:
    """Return the sum of coefficient(k) x^k."""
    total, power, k = Decimal(0), Decimal(1), 0
    while abs(power * coefficient(k)) > TINY:
        total += power * coefficient(k)
        power, k = power * x, k + 1
    return total


def arc_tangent(inverse: int) -> Decimal:
    """Return atan(1 / inverse)."""
    x = Decimal(1) / inverse
    return x * series(lambda k: Decimal((-1) ** k) / (2 * k + 1), x * x)


def pi() -> Decimal:
    """Return pi by Machin's formula."""
    return 4 * (4 * arc_tangent(5) - arc_tangent(239))


def arcs() -> list[Decimal]:
    """Return a, pi/2 - a, pi - a and pi/2 + a for a = 0, atan(1/2) and atan(1)."""
    bases = (Decimal(0), arc_tangent(2), pi() / 4)
    return [
        angle for base in bases for angle in (base, pi() / 2 - base, pi() - base, pi() / 2 + base)
    ]


def cosine_of(angle: Decimal) -> Decimal:
    """Return cos(angle)."""
    return series(lambda k: Decimal((-1) ** k) / factorial(2 * k), angle * angle)


def interpolate(
    function: Callable[[Decimal], Decimal], interval: tuple[Decimal, Decimal], count: int
) -> list[Decimal]:
    """Return the coefficients of the polynomial that meets `function` at `count` Chebyshev nodes of `interval`."""
    lower, upper = interval
    zeros = [cosine_of(pi() * (2 * i + 1) / (2 * count)) for i in range(count)]
    nodes = [(lower + upper) / 2 + (upper - lower) / 2 * zero for zero in zeros]
    divided = [function(node) for node in nodes]
    for order in range(1, count):
        for i in range(count - 1, order - 1, -1):
            divided[i] = (divided[i] - divided[i - 1]) / (nodes[i] - nodes[i - order])
    polynomial = [Decimal(0)] * count
    for node, difference in zip(reversed(nodes), reversed(divided), strict=True):
        shifted = [difference, *polynomial[:-1]]
        polynomial = [a - node * b for a, b in zip(shifted, polynomial, strict=True)]
    return polynomial


def coefficients(remainder: Remainder) -> list[float]:
    """Return the coefficients of a remainder as they stand in the kernels."""
    exact = interpolate(lambda x: series(remainder.taylor, x), remainder.interval, remainder.count)
    return [float(value) for value in (remainder.taylor(0), *exact[1:])]


def largest_error(remainder: Remainder, values: list[float], samples: int = 500) -> float:
    """Return the largest relative error of the function that the polynomial makes, without the rounding of sums."""
    lower, upper = remainder.interval
    worst = Decimal(0)
    for i in range(1, samples):
        x = lower + (upper - lower) * i / samples
        polynomial = Decimal(0)
        for value in reversed(values):
            polynomial = polynomial * x + Decimal(value)
        worst = max(worst, abs(remainder.error(x) * (polynomial - series(remainder.taylor, x))))
    return float(worst)


def parts(value: Decimal, *bits: int) -> list[float]:
    """Return doubles that add up to `value`, cut off behind the last: each holds as many of its bits as asked for."""
    found = []
    for count in bits:
        unit = Decimal(2) ** (math.frexp(float(value))[1] - count)
        found.append(float(value // unit * unit))
        value -= Decimal(found[-1])
    return found


def main() -> None:
    """Print the constants and the errors."""
    getcontext().prec = DIGITS
    print(f"_LOG2_E = {float(1 / Decimal(2).ln())}")
    print(f"_TWO_BY_PI = {float(2 / pi())}")
    print("_LN2 =", tuple(parts(Decimal(2).ln(), 32, 53)))
    print("_HALF_PI =", tuple(parts(pi() / 2, 32, 32, 32)))
    print("_ARCS = (", *(f"    {tuple(parts(angle, 53, 53))}," for angle in arcs()), ")", sep="\n")
    errors = []
    for remainder in remainders():
        values = coefficients(remainder)
        print(f"{remainder.name} = (", *(f"    {value}," for value in values), ")", sep="\n")
        errors.append(f"# {remainder.name}: {largest_error(remainder, values) * 2**53:.2f} x 2^-53")
    print(
        "\n# largest relative errors of the functions by those of the polynomials:",
        *errors,
        sep="\n",
    )


if __name__ == "__main__":
    main()
