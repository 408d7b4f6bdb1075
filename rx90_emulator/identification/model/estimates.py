"""Estimates of friction parameters with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_emulator.identification.records.record import BagSource

SLIDING = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "omega_s", "delta", "c2")
VISCOUS_EXPONENT = "alpha"
"""Of the sliding regime too, and estimated where the data prefer another value than 1."""
PRESLIDING = ("c0", "c1")
PARAMETERS = (*SLIDING, VISCOUS_EXPONENT, *PRESLIDING)
LARGEST_DEVIATION = 0.3
"""Relative standard deviation of c0 or c1, up to which it is identifiable."""
_MOST_DECIMALS = 7
LARGEST = 1e12
"""Largest value or deviation that is written, SI units: no bristle is so stiff, and no arm so strong."""


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter.

    Attributes:
        value: the estimate; NaN if it is not identifiable.
        deviation: standard deviation, in the unit of the value; 0 for a value that was given, not estimated.
        identifiable: whether the data determine the value.
        reason: why they do not; empty if they do.
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
        value, deviation = self.value, self.deviation
        if not 0.0 < deviation < math.inf:
            return f"{value:.4g}", f"{deviation:.2g}"
        decimals = 1 - math.floor(math.log10(deviation))
        if decimals > _MOST_DECIMALS:
            return f"{value:.4g}", f"{deviation:.2g}"
        shown = max(0, decimals)
        return f"{round(value, decimals):.{shown}f}", f"{round(deviation, decimals):.{shown}f}"


@dataclass(frozen=True, eq=False)
class ElementEstimate:
    """The parameters of one friction element.

    Attributes:
        element: its name.
        parameters: estimates by the names in PARAMETERS, or a part of them, in that order; p of them.
        correlation: of the estimates, in the order of `parameters`, shape (p, p); NaN where one is not identifiable.
        sources: the bags they rest on.

    Raises:
        IdentificationError: for an unknown parameter, or a correlation of another shape.
    """

    element: str
    parameters: Mapping[str, ParameterEstimate]
    correlation: Array
    sources: tuple[BagSource, ...]

    def __post_init__(self) -> None:
        unknown = [name for name in self.parameters if name not in PARAMETERS]
        if unknown:
            found = f"{plain(self.element)}: parameter {quoted(unknown[0])}"
            raise IdentificationError(f"{found}; accepted: {', '.join(PARAMETERS)}")
        shape = (len(self.parameters), len(self.parameters))
        if self.correlation.shape != shape:
            raise IdentificationError(
                f"{self.element}: correlation of shape {self.correlation.shape}; accepted: {shape}"
            )

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
