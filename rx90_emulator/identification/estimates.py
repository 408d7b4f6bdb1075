"""Estimates of friction parameters with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import LUGRE_PASSIVITY
from rx90_common.friction.parts.part import MIN_SPEED
from rx90_emulator.identification.records import BagSource

SLIDING = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "omega_s", "delta", "c2")
VISCOUS_EXPONENT = "alpha"
"""It belongs to the sliding regime too, and is estimated where the data prefer another value than 1."""
PRESLIDING = ("c0", "c1")
PARAMETERS = (*SLIDING, VISCOUS_EXPONENT, *PRESLIDING)
LARGEST_DEVIATION = 0.3
"""Relative standard deviation of c0 or c1, up to which it is identifiable."""
NOT_IN_MODEL = "the model that was asked for does not have it"
"""Why a parameter has no estimate if its part is not in the model that the user asked for: the part is off."""
_DAMPING_FADE_SPEED = 1.0  # rad/s, as of the shipped RX90B
_MAX_DECIMALS = 7
LARGEST = 1e12
"""Largest value or deviation that is written, SI units: no bristle is so stiff, and no arm so strong."""


def digits(value: float, count: int = 6) -> float:
    """Round a value to `count` digits: 6 are far finer than any standard deviation, 12 hide rounding errors."""
    return float(f"{value:.{count}g}")


def with_passive_fading(element: FrictionElement, fallback: FrictionElement | None) -> FrictionElement:
    """Return an element with the omega_d of a fallback, or 1 rad/s without one, or less, so that c1 gives no energy.

    The largest of c1 v exp(-(v / omega_d)^2) is c1 omega_d / sqrt(2 e), and the element is passive at every speed while
    that is below p tau_c, with p the bristles' factor: half of it is taken.
    """
    usual = _DAMPING_FADE_SPEED if fallback is None else fallback.omega_d
    bristles = element.bristles
    least = min(element.tau_c.positive, element.tau_c.negative)
    factor = LUGRE_PASSIVITY if bristles is None else float(bristles.passivity_factor(element.c0, 0.0))
    passive = 0.5 * factor * math.sqrt(2.0 * math.e) * least / max(element.c1, 1e-300)
    return element.replaced(omega_d=min(usual, max(passive, MIN_SPEED)))


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter.

    Attributes:
        value: the estimate; NaN if it is not identifiable.
        deviation: standard deviation, in the unit of the value; 0 for a value that was given, not estimated.
        identifiable: whether the data determine the value.
        reason: why they do not; empty if identifiable.
    """

    value: float
    deviation: float
    identifiable: bool = True
    reason: str = ""

    @classmethod
    def unknown(cls, reason: str) -> ParameterEstimate:
        """Return the estimate of a parameter that is not identifiable."""
        return cls(math.nan, math.inf, False, reason)

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the confidence interval at 95 %."""
        return self.value - 1.96 * self.deviation, self.value + 1.96 * self.deviation

    def texts(self) -> tuple[str, str]:
        """Return value and deviation, rounded to the second significant digit of the deviation: 28.03 and 0.10."""
        value = self.value
        deviation = self.deviation
        decimals = 1 - math.floor(math.log10(deviation)) if 0.0 < deviation < math.inf else _MAX_DECIMALS + 1
        if decimals > _MAX_DECIMALS:
            return f"{value:.4g}", f"{deviation:.2g}"
        shown = max(0, decimals)
        return f"{round(value, decimals):.{shown}f}", f"{round(deviation, decimals):.{shown}f}"


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Measured and identified friction torque of one element against its velocity.

    Attributes:
        velocity: of p measured points, rad/s, shape (p,).
        torque: measured torque less the rigid arm's and the other elements', Nm, shape (p,).
        deviation: standard deviation of its noise, Nm, shape (p,); 0 where it is not known.
        fitted: torque by the identified parameters, Nm, shape (p,).
        line: the identified curve over the measured speeds, in either direction: velocity, torque, and the standard
            deviation of the torque due to the parameters, shape (3, k).
    """

    velocity: Array
    torque: Array
    deviation: Array
    fitted: Array
    line: Array

    @property
    def rms(self) -> float:
        """Return the RMS residual torque, Nm."""
        return float(np.sqrt(np.mean((self.torque - self.fitted) ** 2)))

    @property
    def share(self) -> float:
        """Return the residual torque over the friction torque, RMS; NaN without friction."""
        friction = float(np.sqrt(np.mean(self.torque**2)))
        return self.rms / friction if friction > 0.0 else math.nan

    @property
    def chi2(self) -> float:
        """Return the mean square of the residuals over what the samples' noise leaves; 1 for noise alone."""
        return float(np.mean(((self.torque - self.fitted) / np.maximum(self.deviation, 1e-12)) ** 2))


@dataclass(frozen=True, eq=False)
class ElementEstimate:
    """The parameters of one friction element.

    Attributes:
        element: its name.
        parameters: p estimates, by all or some of the names in PARAMETERS, in that order.
        correlation: of the estimates, in the order of `parameters`, shape (p, p); NaN where one is not identifiable.
        sources: the bags that the estimates come from.
    """

    element: str
    parameters: Mapping[str, ParameterEstimate]
    correlation: Array
    sources: tuple[BagSource, ...]

    @classmethod
    def of(
        cls,
        element: str,
        parameters: Mapping[str, ParameterEstimate],
        covariance: Array,
        sources: tuple[BagSource, ...],
    ) -> ElementEstimate:
        """Return the estimates of an element; the covariance, shape (p, p), may be that of scaled parameters."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        known = np.array([one.identifiable for one in parameters.values()])
        scale = np.where(known & (deviation > 0.0), deviation, np.nan)
        return cls(element, parameters, covariance / np.outer(scale, scale), sources)

    @classmethod
    def unknown(
        cls, element: str, names: tuple[str, ...], reason: str, sources: tuple[BagSource, ...] = ()
    ) -> ElementEstimate:
        """Return the estimates of an element of which no parameter is identifiable, for the same reason."""
        estimates = dict.fromkeys(names, ParameterEstimate.unknown(reason))
        return cls(element, estimates, np.full((len(names), len(names)), np.nan), sources)

    def covariance(self) -> Array:
        """Return the covariance in the order of `parameters`, shape (p, p); 0 for what is not identifiable."""
        deviation = np.array([e.deviation if e.identifiable else 0.0 for e in self.parameters.values()])
        return np.asarray(np.nan_to_num(self.correlation) * np.outer(deviation, deviation))


@dataclass(frozen=True, eq=False)
class IdentifiedElement:
    """One friction element with the estimates of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS, without the viscous exponent where it is 1; those of a part by names
            such as bristles.break_away.
        sources: the bags that each parameter was estimated from.
        given_bristles: whether its bristles, of another kind than LuGre's, are the fallback's, as its c0 is.
    """

    element: FrictionElement
    estimates: dict[str, ParameterEstimate]
    sources: dict[str, tuple[BagSource, ...]]
    given_bristles: bool = False

    @classmethod
    def of(
        cls,
        element: FrictionElement,
        estimates: Mapping[str, ParameterEstimate],
        sources: dict[str, tuple[BagSource, ...]],
        fallback: FrictionElement | None,
    ) -> IdentifiedElement:
        """Return an element with the fallback's bristles where its c0 is the fallback's: they belong together.

        Args:
            element: to simulate with.
            estimates: of its parameters.
            sources: of the estimates.
            fallback: source of values that are not identifiable; None without one.
        """
        part = None if fallback is None else fallback.bristles
        if part is None or ("c0" in estimates and estimates["c0"].identifiable):
            return cls(element, dict(estimates), sources)
        unknown = ParameterEstimate.unknown("it goes with c0, which is not identified")
        numbers = {f"bristles.{name}": unknown for name in part.numbers()}
        return cls(element.replaced(bristles=part), {**estimates, **numbers}, sources, given_bristles=True)
