"""From the selected model to the parameters of FrictionElement, with deviations, or the reason why one is not known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.law import FITTED, VISCOUS, Part
from rx90_emulator.identification.excitation.friction.models import FittedElement
from rx90_emulator.identification.model.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.records.record import BagSource

_UNTOLD = 0.3  # deviation of an exponent that says nothing about it
_LARGEST = {"omega_s": 0.5, "delta": 0.5, "c0": 0.5, "c1": 0.25}
"""Relative deviation up to which one of these counts as known.

Damping is kept where it happens to come out large: of values that stand out by less than four deviations, most are too
large.
"""

Refusal = Callable[[Part], str]


def element_estimate(one: FittedElement, refusal: Refusal, sources: tuple[BagSource, ...]) -> ElementEstimate:
    """Return the estimates of an element by the names of FrictionElement.

    Args:
        one: the element as it was fitted.
        refusal: why it does not have a part.
        sources: the runs.
    """
    slopes = _natural(one)
    names = tuple(slopes)
    jacobian = np.array([slope for _, slope in slopes.values()])
    known = np.isfinite(np.diag(one.covariance))
    finite = np.where(np.outer(known, known), one.covariance, 0.0)
    covariance = jacobian @ finite @ jacobian.T
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    deviations[(jacobian[:, ~known] != 0.0).any(axis=1)] = math.inf
    estimates = {}
    for name, deviation in zip(names, deviations.tolist(), strict=True):
        value = slopes[name][0]
        reason = _reason(one, name, value, deviation, refusal)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else ParameterEstimate(value, deviation)
    return ElementEstimate.of(one.element, estimates, covariance, sources)


def _natural(one: FittedElement) -> dict[str, tuple[float, Array]]:
    """Return values by name with their derivatives by the parameters of the fit, shape (8,)."""
    shape = one.shape
    tau_c, c2, c1 = one.linear.tolist()

    def by(**slopes: float) -> Array:
        return np.array([slopes.get(name, 0.0) for name in FITTED])

    coulomb = (tau_c, by(tau_c=1.0))
    static, omega_s, c0 = coulomb, (math.nan, by()), (math.nan, by())
    if Part.STRIBECK in shape.parts:
        static = (tau_c * (1.0 + shape.rise), by(tau_c=1.0 + shape.rise, rise=tau_c))
        omega_s = (shape.omega_s, by(omega_s=shape.omega_s))
    if Part.BRISTLE in shape.parts:
        c0 = (tau_c * shape.stiffness, by(tau_c=shape.stiffness, stiffness=tau_c * shape.stiffness))
    return {
        "tau_c_positive": coulomb, "tau_c_negative": coulomb, "tau_s_positive": static, "tau_s_negative": static,
        "omega_s": omega_s, "delta": (shape.delta, by(delta=1.0)), "c2": (c2, by(c2=1.0)),
        "alpha": (shape.alpha, by(alpha=1.0)), "c0": c0, "c1": (c1, by(c1=1.0)),
    }  # fmt: skip


_PART_OF = {
    "tau_s_positive": Part.STRIBECK, "tau_s_negative": Part.STRIBECK, "omega_s": Part.STRIBECK, "delta": Part.STRIBECK,
    "c0": Part.BRISTLE, "c1": Part.DAMPING,
}  # fmt: skip


def _reason(one: FittedElement, name: str, value: float, deviation: float, refusal: Refusal) -> str:
    """Return why a parameter is not known; empty if it is."""
    part = _PART_OF.get(name)
    if part is not None and part not in one.shape.parts:
        return refusal(part)
    if name == "delta" and "delta" in one.shape.fixed:
        return "not told from the size of the rise; 1 was assumed"
    weak = deviation > (_UNTOLD if name == "alpha" else _LARGEST[name] * value if name in _LARGEST else math.inf)
    checks = (
        (not one.linear.any(), "the element does not move, or at one velocity alone"),
        (name.startswith("tau") and value <= 0.0, "no Coulomb friction shows: the best value is 0"),
        (name in ("c2", "alpha") and one.linear[VISCOUS] <= 0.0, "no viscous friction shows: the best value is 0"),
        (not math.isfinite(value) or not math.isfinite(deviation), "the runs do not determine it"),
        (weak, f"standard deviation {deviation:.3g} at a value of {value:.3g}"),
    )
    return next((reason for applies, reason in checks if applies), "")
