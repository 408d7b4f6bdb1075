"""Estimates of friction parameters with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from rx90_common.base.arrays import Array, Mask, rms
from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import quoted
from rx90_common.estimation.deviations import Deviations
from rx90_common.estimation.elements import places
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import Law, Part
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import LUGRE_PASSIVITY
from rx90_common.friction.parts.part import MIN_SPEED
from rx90_emulator.identification.options import COULOMB_VISCOUS, MODEL_PARTS
from rx90_emulator.identification.records import BagSource

SLIDING = (
    "tau_c_positive",
    "tau_c_negative",
    "tau_s_positive",
    "tau_s_negative",
    "omega_s",
    "delta",
    "c2",
)
VISCOUS_EXPONENT = "alpha"
"""It belongs to the sliding regime too, and is estimated where the data prefer another value than 1."""
PRESLIDING = ("c0", "c1")
PARAMETERS = (*SLIDING, VISCOUS_EXPONENT, *PRESLIDING)
LARGEST_DEVIATION = 0.3
"""Relative standard deviation of c0 or c1, up to which it is identifiable."""
_DAMPING_FADE_SPEED = 1.0  # rad/s, as of the shipped RX90B
_MAX_DECIMALS = 7
LARGEST = 1e12
"""Largest value or deviation that is written, SI units: no bristle is so stiff, and no arm so strong."""


def digits(value: float, count: int = 6) -> float:
    """Round a value to `count` digits: 6 are far finer than any standard deviation, 12 hide rounding errors."""
    return float(f"{value:.{count}g}")


def with_passive_fading(
    element: FrictionElement, fallback: FrictionElement | None
) -> FrictionElement:
    """Return an element with the omega_d of a fallback, or 1 rad/s without one, or less, so that c1 gives no energy.

    The largest of c1 v exp(-(v / omega_d)^2) is c1 omega_d / sqrt(2 e), and the element is passive at every speed while
    that is below p tau_c, with p the bristles' factor: half of it is taken.
    """
    usual = _DAMPING_FADE_SPEED if fallback is None else fallback.omega_d
    least = min(element.tau_c.positive, element.tau_c.negative)
    passive = 0.5 * LUGRE_PASSIVITY * math.sqrt(2.0 * math.e) * least / max(element.c1, 1e-300)
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
        decimals = (
            1 - math.floor(math.log10(deviation))
            if 0.0 < deviation < math.inf
            else _MAX_DECIMALS + 1
        )
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
        return rms(self.torque - self.fitted)

    @property
    def share(self) -> float:
        """Return the residual torque over the friction torque, RMS; NaN without friction."""
        friction = rms(self.torque)
        return self.rms / friction if friction > 0.0 else math.nan

    @property
    def chi2(self) -> float:
        """Return the mean square of the residuals over what the samples' noise leaves; 1 for noise alone."""
        residual = (self.torque - self.fitted) / np.maximum(self.deviation, 1e-12)
        return float(np.mean(residual**2))


Estimates: TypeAlias = dict[str, ParameterEstimate]
"""Estimates of one element, by all or some of the names in PARAMETERS, in that order."""


def unknown_estimates(names: Sequence[str], reason: str) -> Estimates:
    """Return the estimates of parameters none of which is identifiable, for the same reason."""
    return dict.fromkeys(names, ParameterEstimate.unknown(reason))


class FittedLaw(NamedTuple):
    """The fitted law of one element.

    Attributes:
        law: of the element.
        x: its fitted parameters, shape (k,).
        covariance: of these, shape (k, k).
        determined: which of them the data determine, shape (k,).
    """

    law: Law
    x: Array
    covariance: Array
    determined: Mask

    def curve(self, velocity: Array) -> tuple[Array, Array]:
        """Return the torque of steady sliding at velocities, rad/s, and its deviation, Nm, shape (m,) each."""
        torque, slopes = self.law.curve(velocity, self.x)
        variance = np.einsum("ki,ij,kj->k", slopes, self.covariance, slopes)
        return torque, np.sqrt(np.maximum(variance, 0.0))

    def estimates(self, doubt: Callable[[str, float, float, bool], str]) -> Estimates:
        """Return the estimates of the parameters that the law has.

        Args:
            doubt: returns why a parameter is not identifiable, "" if it is, by its name, its value, its standard
                deviation, and whether the data determine it.
        """
        values, slopes = self.law.natural(self.x)
        variance = np.diag(slopes @ self.covariance @ slopes.T)
        deviations = np.sqrt(np.maximum(variance, 0.0)).tolist()
        known = (slopes[:, ~self.determined] == 0.0).all(axis=1).tolist()
        estimates = {}
        for name, deviation, determined in zip(values, deviations, known, strict=True):
            reason = doubt(name, values[name], deviation, determined)
            estimate = ParameterEstimate(values[name], deviation)
            estimates[name] = ParameterEstimate.unknown(reason) if reason else estimate
        return estimates


def fitted_laws(laws: Sequence[Law], fit: Fit, spread: Deviations) -> list[FittedLaw]:
    """Return the fitted law of each element, whose parameters stand one element after the other."""
    return [
        FittedLaw(law, fit.x[place], spread.covariance[place, place], spread.determined[place])
        for law, place in zip(laws, places(laws), strict=True)
    ]


def least_coulomb(
    elements: Mapping[str, Estimates], fallback: Sequence[FrictionElement] | None
) -> float:
    """Return the least identified Coulomb torque, Nm, which is assumed for elements without any; 0 if none is."""
    coulomb = {name: estimates["tau_c_positive"] for name, estimates in elements.items()}
    known = [estimate.value for estimate in coulomb.values() if estimate.identifiable]
    if not known and fallback is None:
        reasons = "; ".join(f"{name}: {estimate.reason}" for name, estimate in coulomb.items())
        raise IdentificationError(
            f"no friction of any element is identified ({reasons}); accepted: recordings that tell some, or --fallback "
            "with a friction file"
        )
    return min(known, default=0.0)


@dataclass(frozen=True, eq=False)
class IdentifiedElement:
    """One friction element with the estimates of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS, without the viscous exponent where it is 1.
        sources: the bags that each parameter was estimated from.
    """

    element: FrictionElement
    estimates: Estimates
    sources: Mapping[str, tuple[BagSource, ...]]


def model_parts(model: Sequence[str]) -> tuple[Part, ...]:
    """Return the parts of a model beside Coulomb and viscous friction, which every model has."""
    unknown = [name for name in model if name not in (COULOMB_VISCOUS, *MODEL_PARTS)]
    if unknown or not model:
        wrong = quoted(unknown[0]) if unknown else "no part"
        raise ConfigError(
            f"--model: {wrong}; accepted: {', '.join((COULOMB_VISCOUS, *MODEL_PARTS))}"
        )
    return tuple(part for part in Part if part.value in model)
