"""Rises and bristle damping that the runs neither show nor exclude: what other parameters' deviations owe to them.

A rise near the least speeds bends the curve the other way than an exponent below 1, and lifts what looks like Coulomb
friction. Where cross-validation did not keep one, a rise of some size may still be there: covariances are then those
of the model in which it lies anywhere from 0 on. Static torque below Coulomb torque is no friction, and more than twice
the Coulomb torque is assumed not to occur; fits know nothing of either and may say -125 % with a deviation of 197 %.

A bristle without its damping c1 takes the torque of the damping for its own, which is in the same rows: it comes out
stiffer by 5 to 10 %. Each bristle whose damping was not kept may have one of any size from 0 on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.law import COULOMB, ElementShape, Part
from rx90_emulator.identification.excitation.friction.selection import Key, Selected, candidates
from rx90_emulator.identification.excitation.friction.separable import best_start
from rx90_emulator.identification.excitation.friction.weighted import WeightedProblem
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.prior import Prior

_WORTH = {Part.STRIBECK: 0.2, Part.DAMPING: 0.0}  # of tau_c, Nm s/rad: what matters
_CERTAIN = 2.0  # deviations
_LARGEST = {Part.STRIBECK: 1.0, Part.DAMPING: math.inf}  # of tau_c, Nm s/rad: none is larger (assumed)


def undecided_parts(
    selected: Selected, columns: Array, prior: Prior | None = None
) -> tuple[dict[Key, tuple[float, float]], Array | None]:
    """Return rises and bristle damping that may be there, though they were not kept.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        prior: of the first parameters.

    Returns:
        Value and standard deviation by element and part, as fitted without bounds, of rises over tau_c, of damping in
        Nm s/rad; and the covariance of the q parameters with these parts within their bounds, shape (q, q), if there
        are any.
    """
    weighted, fit = selected.weighted, selected.fit
    table = {}
    for e, part in sorted(selected.refused, key=lambda key: (key[1].value, key[0])):
        shape = fit.shapes[e]
        beside = part is Part.STRIBECK or (part is Part.DAMPING and Part.BRISTLE in shape.parts)
        if beside and part not in shape.parts and fit.linear[e, COULOMB] > 0.0:
            table[e, part] = _column(weighted, fit.shapes, fit.linear, e, part)
    while table:
        wide = solve(weighted.problem, np.column_stack([columns, *table.values()]), prior=prior)
        found = _sizes(wide, tuple(table))
        kept = {key: table[key] for key, (value, deviation) in found.items()
                if value + _CERTAIN * deviation > _WORTH[key[1]]}  # fmt: skip
        if len(kept) == len(table):
            largest = [_LARGEST[part] for _, part in found]
            return found, _bounded(wide.covariance, list(found.values()), largest)
        table = kept
    return {}, None


def _sizes(fit: LinearFit, keys: Sequence[Key]) -> dict[Key, tuple[float, float]]:
    """Return the last values of a fit with their deviations, one for each part."""
    values, deviations = (part[len(part) - len(keys) :].tolist() for part in (fit.value, fit.deviation))
    return dict(zip(keys, zip(values, deviations, strict=True), strict=True))


def _bounded(covariance: Array, sizes: Sequence[tuple[float, float]], largest: Sequence[float]) -> Array:
    """Return the covariance of all but the last parameters, where these lie between 0 and `largest`.

    The values hold for sizes of 0: what one shifts is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between sizes stay.
    """
    count = len(covariance) - len(sizes)
    between = covariance[count:, count:]
    if not np.isfinite(between).all():
        return np.asarray(covariance[:count, :count])
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    pairs = zip(sizes, largest, strict=True)
    factor = np.array([_size_within(value, deviation, most) / deviation for (value, deviation), most in pairs])
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


def _size_within(value: float, deviation: float, most: float) -> float:
    """Return the root mean square of a normal variable that lies between 0 and `most`."""
    inside = truncnorm(-value / deviation, (most - value) / deviation, value, deviation)
    return float(np.sqrt(inside.moment(2)))


def _column(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], linear: Array, element: int, part: Part
) -> Array:
    """Return the torque per unit of an element's part, a rise with the Stribeck velocity that suits it, shape (r,)."""
    begun = replace(shapes[element], parts=shapes[element].parts | {part})
    if part is Part.STRIBECK:
        begun = replace(begun, fixed=begun.fixed | {"omega_s", "delta"})
        begun = best_start(weighted, shapes, element, candidates(weighted, begun, element, part))
    there = [*shapes[:element], begun, *shapes[element + 1 :]]
    return weighted.column(there, linear, element, "rise" if part is Part.STRIBECK else "c1") / weighted.weight
