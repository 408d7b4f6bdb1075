"""Which parameters of the sliding regime are identifiable, with which deviations, and why others are not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.model.estimates import SLIDING, VISCOUS_EXPONENT, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.records.record import BagSource
from rx90_emulator.identification.sliding import stribeck
from rx90_emulator.identification.sliding.solver import SlidingSolution
from rx90_emulator.identification.sliding.usage import BagUse, unused_speeds

_SIGNIFICANT = 3.0  # standard deviations of the Stribeck rise from 0
_LARGEST = 0.3  # relative standard deviation up to which a parameter is identifiable
_SAME = 0.98  # correlation from which two parameters cannot be separated
_SYSTEMATIC = 1e-3
"""Relative standard deviation that repetition does not show: the mean of a sampled torque, rippling in step with the
sampling, is off by so much even far from a beat (measured on the engine, whose parameters are known)."""
_FITTED = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c2", "omega_s", "delta", "alpha")
"""The parameters of the fit by the names that they determine."""
_STRIBECK = ("tau_s_positive", "tau_s_negative", "omega_s", "delta")
_OMEGA_S = 5  # place in the fit
_LEAST_BEND = 0.02  # distance of a viscous exponent from 1 that counts


def without_stribeck(solution: SlidingSolution) -> Mask:
    """Return which elements show no Stribeck effect, shape (n_el,): no significant rise, or omega_s at its bound."""
    flat = np.zeros(len(solution.free), dtype=np.bool_)
    for e in np.flatnonzero(solution.free[:, stribeck.SHAPE].all(axis=1)).tolist():
        rise = solution.parameters[e, stribeck.RISE]
        deviation = np.sqrt(np.diag(_block(solution, e)))[stribeck.RISE]
        # At a bound the deviation means nothing; a rise of 0 is on it.
        flat[e] = bool((rise < _SIGNIFICANT * deviation).all()) or bool(solution.at_bound[e, _OMEGA_S])
    return flat


def with_viscous_exponent(solution: SlidingSolution) -> Mask:
    """Return which elements show a viscous exponent other than 1, shape (n_el,): significantly so, and not at a bound.

    The deviations are those of the result: a misfit that plateaus or speeds share does not count as evidence.
    """
    bent = np.zeros(len(solution.free), dtype=np.bool_)
    for e in np.flatnonzero(solution.free[:, stribeck.EXPONENT]).tolist():
        away = abs(float(np.exp(solution.parameters[e, stribeck.EXPONENT])) - 1.0)
        deviation = float(np.sqrt(natural_covariance(solution, e)[-1, -1]))
        at_bound = bool(solution.at_bound[e, stribeck.EXPONENT])
        bent[e] = away > max(_LEAST_BEND, _SIGNIFICANT * deviation) and not at_bound
    return bent


def element_estimate(
    solution: SlidingSolution,
    names: Sequence[str],
    element: int,
    sources: tuple[BagSource, ...],
    usage: Sequence[BagUse],
) -> ElementEstimate:
    """Return the estimates of one element that was fitted.

    Args:
        solution: of the fit.
        names: of all elements.
        element: index of this one.
        sources: the bags.
        usage: what was used of each.
    """
    values = stribeck.natural(solution.parameters[element])
    covariance = natural_covariance(solution, element)
    estimates = {}
    names_here = (*SLIDING, VISCOUS_EXPONENT) if solution.free[element, stribeck.EXPONENT] else SLIDING
    covariance = covariance[: len(names_here), : len(names_here)]
    for name, deviation in zip(names_here, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        estimate = ParameterEstimate(values[name], deviation)
        reason = _reason(solution, names, element, name, estimate, usage)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else estimate
    return ElementEstimate.of(names[element], estimates, covariance, sources)


def natural_covariance(solution: SlidingSolution, element: int) -> Array:
    """Return the covariance of an element's parameters as `stribeck.natural` has them, shape (8, 8).

    It is that of the fit, times the squared t factor and the design effect of plateaus at one speed or, where it is
    larger, the factor of a misfit, plus what repetition does not show.
    """
    transform = stribeck.natural_jacobian(solution.parameters[element])
    design = float(solution.design_effect[solution.rows.gain[:, element] != 0.0].mean())
    wider = np.sqrt(np.maximum(design, solution.misfit.widening[element]))
    block = wider[:, None] * _block(solution, element) * wider
    covariance = transform @ block @ transform.T * _t_factor(solution, element) ** 2
    values = stribeck.natural(solution.parameters[element])
    # Independent for each parameter, so that no correlation changes its sign.
    unseen = _SYSTEMATIC * np.array(list(values.values()))
    if not solution.free[element, stribeck.EXPONENT]:
        unseen[-1] = 0.0
    return np.asarray(covariance + np.diag(unseen**2))


def _block(solution: SlidingSolution, element: int) -> Array:
    rows = slice(element * stribeck.SIZE, (element + 1) * stribeck.SIZE)
    return solution.covariance[rows, rows]


def _t_factor(solution: SlidingSolution, element: int) -> float:
    """Return the ratio of Student's 97.5 % quantile to the normal one.

    The degrees of freedom are Satterthwaite's: with the intraclass correlation of a plateau's blocks each plateau is
    one observation, with the rest of the variance each block is one.
    """
    mine = solution.rows.gain[:, element] != 0.0
    common = float(solution.common[mine].mean())
    fitted = int(solution.free[element].sum())
    plateaus = max(1, len(np.unique(solution.rows.plateau[mine])) - fitted)
    blocks = max(1, int(mine.sum()) - fitted)
    freedom = 1.0 / (common**2 / plateaus + (1.0 - common) ** 2 / blocks)
    return float(student.ppf(0.975, freedom) / student.ppf(0.975, np.inf))


def _reason(
    solution: SlidingSolution,
    names: Sequence[str],
    element: int,
    name: str,
    estimate: ParameterEstimate,
    usage: Sequence[BagUse],
) -> str:
    """Return why a parameter is not identifiable; empty if it is."""
    if name in _STRIBECK and not solution.free[element, stribeck.SHAPE].any():
        speed = np.abs(solution.rows.velocity[solution.rows.gain[:, element] != 0.0, element])
        lacking = unused_speeds(usage, element, float(speed.min()))
        slower = f"; what it does at {lacking[0]:.3g} rad/s was recorded, but could not be used" if len(lacking) else ""
        return f"no Stribeck effect shows at speeds from {speed.min():.3g} to {speed.max():.3g} rad/s{slower}"
    if estimate.deviation > _LARGEST * abs(estimate.value):
        partner = _partner(solution, names, element, name)
        size = f"standard deviation {estimate.deviation:.3g} at a value of {estimate.value:.3g}"
        size += ", as the curve does not fit" * bool(solution.misfit.significant[element])
        return f"not separable from {partner}: {size}" if partner else size
    if name in ("omega_s", "delta") and solution.at_bound[element, _FITTED.index(name)]:
        return f"at the bound of its range, {estimate.value:.3g}"
    return ""


def _partner(solution: SlidingSolution, names: Sequence[str], element: int, name: str) -> str:
    """Return the parameter, with its element, that this one is fully correlated with, or nothing."""
    own = element * stribeck.SIZE + _FITTED.index(name)
    deviation = np.sqrt(np.diag(solution.covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.abs(solution.covariance[own] / (deviation * deviation[own]))
    correlation[~solution.free.ravel()] = 0.0
    correlation[own] = 0.0
    other = int(np.nanargmax(correlation))
    if not correlation[other] > _SAME:
        return ""
    return f"{_FITTED[other % stribeck.SIZE]} of {names[other // stribeck.SIZE]}"
