"""Stribeck rises that the runs neither show nor exclude: what the other parameters' deviations owe to them.

A rise near the least speeds bends the curve the other way than an exponent below 1, and lifts what looks like Coulomb
friction. Where cross-validation did not keep one, a rise of some size may still be there: covariances are then those
of the model in which it lies anywhere from 0 on. Static torque below Coulomb torque is no friction, and more than twice
the Coulomb torque is assumed not to occur; fits know nothing of either and may say -125 % with a deviation of 197 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.law import COULOMB, ElementShape, Part
from rx90_emulator.identification.excitation.friction.selection import Selected, candidates
from rx90_emulator.identification.excitation.friction.separable import best_start
from rx90_emulator.identification.excitation.friction.weighted import WeightedProblem
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.prior import Prior

_WORTH = 0.2  # of tau_c: a rise that matters
_CERTAIN = 2.0  # deviations
_LARGEST = 1.0  # of tau_c: no rise is larger (assumed)


def undecided_rises(
    selected: Selected, columns: Array, prior: Prior | None = None
) -> tuple[dict[int, tuple[float, float]], Array | None]:
    """Return rises that may be there, though they were not kept.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        prior: of the first parameters.

    Returns:
        Value and standard deviation over tau_c by element, as fitted without bounds, and the covariance of the q
        parameters with these rises between 0 and tau_c, shape (q, q), if there are any.
    """
    weighted, fit = selected.weighted, selected.fit
    tried = [e for e, part in selected.refused if part is Part.STRIBECK]
    open_ones = sorted({e for e in tried if Part.STRIBECK not in fit.shapes[e].parts and fit.linear[e, COULOMB] > 0.0})
    table = {e: _column(weighted, fit.shapes, fit.linear, e) for e in open_ones}
    while table:
        wide = solve(weighted.problem, np.column_stack([columns, *table.values()]), prior=prior)
        found = _sizes(wide, tuple(table))
        kept = {e: table[e] for e, (value, deviation) in found.items() if value + _CERTAIN * deviation > _WORTH}
        if len(kept) == len(table):
            return found, _bounded(wide.covariance, list(found.values()))
        table = kept
    return {}, None


def _sizes(fit: LinearFit, elements: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Return the last values of a fit with their deviations, one for each element."""
    values, deviations = (part[len(part) - len(elements) :].tolist() for part in (fit.value, fit.deviation))
    return dict(zip(elements, zip(values, deviations, strict=True), strict=True))


def _bounded(covariance: Array, rises: Sequence[tuple[float, float]]) -> Array:
    """Return the covariance of all but the last parameters, where these, the rises, lie between bounds.

    The values hold for rises of 0: what one shifts is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between rises stay.
    """
    count = len(covariance) - len(rises)
    between = covariance[count:, count:]
    if not np.isfinite(between).all():
        return np.asarray(covariance[:count, :count])
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    factor = np.array([_size_within(value, deviation) / deviation for value, deviation in rises])
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


def _size_within(value: float, deviation: float) -> float:
    """Return the root mean square of a normal variable that lies between 0 and _LARGEST."""
    inside = truncnorm(-value / deviation, (_LARGEST - value) / deviation, value, deviation)
    return float(np.sqrt(inside.moment(2)))


def _column(weighted: WeightedProblem, shapes: Sequence[ElementShape], linear: Array, element: int) -> Array:
    """Return the torque per unit of an element's rise, at the Stribeck velocity that suits it best, Nm, shape (r,)."""
    shape = shapes[element]
    begun = replace(shape, parts=shape.parts | {Part.STRIBECK}, fixed=shape.fixed | {"omega_s", "delta"})
    best = best_start(weighted, shapes, element, candidates(weighted, begun, element, Part.STRIBECK))
    there = [*shapes[:element], best, *shapes[element + 1 :]]
    return weighted.column(there, linear, element, "rise") / weighted.weight
