"""Which parameters the data tell, how well, and why not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from rx90_emulator.identification.estimate import SLIDING, ElementEstimate, Estimate, Source
from rx90_emulator.identification.sliding import stribeck
from rx90_emulator.identification.sliding.rows import SlidingRows
from rx90_emulator.identification.sliding.solver import Solution

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SIGNIFICANT = 3.0  # deviations of the Stribeck rise from 0
_LARGEST = 0.3  # deviation over value of a parameter that counts as told
_SAME = 0.98  # correlation of parameters that the data do not tell apart
_SYSTEMATIC = 1e-3
"""Share of a value that repetition does not show: the mean of a sampled torque, rippling in step with the sampling,
is off by so much even far from a beat (measured on the engine, whose parameters are known)."""
_STRIBECK = ("tau_s_positive", "tau_s_negative", "omega_s", "delta")


def without_stribeck(solution: Solution, free: Mask) -> Mask:
    """Return the elements whose data show no Stribeck effect: no significant rise, or one outside the speeds."""
    flat = np.zeros(len(free), dtype=np.bool_)
    for e in np.flatnonzero(free.all(axis=1)).tolist():
        rise = solution.parameters[e, stribeck.RISE]
        deviation = np.sqrt(np.diag(_block(solution, e)))[stribeck.RISE]
        # At a bound the deviation means nothing; a rise of 0 is on it.
        flat[e] = bool((rise < _SIGNIFICANT * deviation).all()) or bool(solution.at_bound[e, 5])
    return flat


def element_estimate(
    rows: SlidingRows,
    solution: Solution,
    free: Mask,
    names: Sequence[str],
    element: int,
    sources: tuple[Source, ...],
    lacking: str | None,
) -> ElementEstimate:
    """Return the estimates of one element.

    Args:
        rows: the equations.
        solution: of the fit.
        free: what was fitted, shape (n_el, 7).
        names: of all elements.
        element: index of this one.
        sources: the bags.
        lacking: why nothing was fitted, if so.
    """
    if lacking is not None:
        unknown = dict.fromkeys(SLIDING, Estimate.unknown(lacking))
        return ElementEstimate(names[element], unknown, np.full((len(SLIDING),) * 2, np.nan), sources)
    values = stribeck.natural(solution.parameters[element])
    covariance = natural_covariance(rows, solution, free, element)
    deviations = np.sqrt(np.diag(covariance))
    estimates = {}
    for k, name in enumerate(SLIDING):
        reason = _reason(rows, solution, free, names, element, name, values[name], deviations[k])
        estimates[name] = Estimate.unknown(reason) if reason else Estimate(values[name], float(deviations[k]))
    known = np.array([estimates[name].identifiable for name in SLIDING])
    scale = np.where(known & (deviations > 0.0), deviations, np.nan)
    return ElementEstimate(names[element], estimates, covariance / np.outer(scale, scale), sources)


def natural_covariance(rows: SlidingRows, solution: Solution, free: Mask, element: int) -> Array:
    """Return the covariance of an element's parameters in the order of SLIDING, shape (7, 7)."""
    transform = stribeck.natural_jacobian(solution.parameters[element])
    covariance = transform @ _block(solution, element) @ transform.T * _few(rows, solution, free, element) ** 2
    covariance *= float(solution.shared[rows.gain[:, element] != 0.0].mean())
    values = stribeck.natural(solution.parameters[element])
    # Independent for each parameter, so that no correlation changes its sign.
    return np.asarray(covariance + np.diag((_SYSTEMATIC * np.array([values[name] for name in SLIDING])) ** 2))


def _block(solution: Solution, element: int) -> Array:
    rows = slice(element * stribeck.SIZE, (element + 1) * stribeck.SIZE)
    return solution.covariance[rows, rows]


def _few(rows: SlidingRows, solution: Solution, free: Mask, element: int) -> float:
    """Return by how much Student's interval is wider than the normal one.

    A plateau is one observation as far as its blocks err together, else each block is one (Satterthwaite).
    """
    mine = rows.gain[:, element] != 0.0
    common = float(solution.common[mine].mean())
    fitted = int(free[element].sum())
    plateaus = max(1, len(np.unique(rows.plateau[mine])) - fitted)
    blocks = max(1, int(mine.sum()) - fitted)
    freedom = 1.0 / (common**2 / plateaus + (1.0 - common) ** 2 / blocks)
    return float(student.ppf(0.975, freedom) / student.ppf(0.975, np.inf))


def _reason(
    rows: SlidingRows,
    solution: Solution,
    free: Mask,
    names: Sequence[str],
    element: int,
    name: str,
    value: float,
    deviation: float,
) -> str:
    """Return why the data do not tell a parameter; empty if they do."""
    if name in _STRIBECK and not free[element, stribeck.SHAPE].any():
        speed = np.abs(rows.velocity[rows.gain[:, element] != 0.0, element])
        return f"no Stribeck effect shows at speeds from {speed.min():.3g} to {speed.max():.3g} rad/s"
    partner = _partner(solution, free, names, element, name)
    if deviation > _LARGEST * abs(value):
        told = f"standard deviation {deviation:.3g} at a value of {value:.3g}"
        return f"cannot be told from {partner}: {told}" if partner else told
    bound = {"omega_s": 5, "delta": 6}.get(name)
    if bound is not None and solution.at_bound[element, bound]:
        return f"runs to the end of its range, {value:.3g}"
    return ""


def _partner(solution: Solution, free: Mask, names: Sequence[str], element: int, name: str) -> str:
    """Return the parameter that takes the place of this one, with its element, or nothing."""
    index = {"tau_c_positive": 0, "tau_c_negative": 1, "tau_s_positive": 2, "tau_s_negative": 3, "c2": 4}
    internal = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c2", "omega_s", "delta")
    own = element * stribeck.SIZE + index.get(name, {"omega_s": 5, "delta": 6}.get(name, 0))
    size = free.size
    deviation = np.sqrt(np.diag(solution.covariance)[:size])
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.abs(solution.covariance[own, :size] / (deviation * deviation[own]))
    correlation[~free.ravel()] = 0.0
    correlation[own] = 0.0
    other = int(np.nanargmax(correlation))
    if not correlation[other] > _SAME:
        return ""
    return f"{internal[other % stribeck.SIZE]} of {names[other // stribeck.SIZE]}"
