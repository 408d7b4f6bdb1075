"""Estimates of friction parameters with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.records import BagSource

SLIDING = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "omega_s", "delta", "c2")
VISCOUS_EXPONENT = "alpha"
"""Of the sliding regime too, and estimated where the data prefer another value than 1."""
PRESLIDING = ("c0", "c1")
PARAMETERS = (*SLIDING, VISCOUS_EXPONENT, *PRESLIDING)
LARGEST_DEVIATION = 0.3
"""Relative standard deviation of c0 or c1, up to which it is identifiable."""
NOT_IN_MODEL = "the model that was asked for does not have it"
"""Why a parameter of a part is not known that a person's model leaves out: the part is off."""
_MAX_DECIMALS = 7
LARGEST = 1e12
"""Largest value or deviation that is written, SI units: no bristle is so stiff, and no arm so strong."""


def digits(value: float, count: int = 6) -> float:
    """Return so many digits of a value: six are far below any standard deviation, twelve above rounding errors."""
    return float(f"{value:.{count}g}")


def cluster_variances(
    slope: Array, residual: Array, cluster: NDArray[np.int64], root: Array, power: float, least: float
) -> Array:
    """Return the variances of q parameters by how far the residuals of each cluster pull them, shape (q,).

    Residuals of a cluster may err together. Those that a fit leaves are too small by its leverage, which is taken off:
    by the root of it the variances are unbiased where there is only noise (CR2), by all of it they are the jackknife's
    over the clusters but for a factor (CR3; Bell and McCaffrey, Survey Methodology 28, 2002).

    Args:
        slope: derivatives of the equations, shape (r, q).
        residual: of unit noise, shape (r,).
        cluster: number of each equation's cluster, -1 where it is in none, shape (r,).
        root: of the covariance with independent residuals, root @ root^T, shape (q, q).
        power: of what the leverage leaves, 0.5 for CR2 and 1 for CR3.
        least: lower bound of what it leaves: without some clusters a parameter would not be determined.
    """
    scaled, total = slope @ root, np.zeros(len(root))
    for number in np.unique(cluster[cluster >= 0]).tolist():
        rows = cluster == number
        leverage, directions = np.linalg.eigh(scaled[rows].T @ scaled[rows])
        pull = directions.T @ (scaled[rows].T @ residual[rows]) / np.maximum(1.0 - leverage, least) ** power
        with np.errstate(over="ignore"):  # what becomes infinite is not identifiable
            total += (root @ (directions @ pull)) ** 2
    return total


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
        decimals = 1 - math.floor(math.log10(deviation)) if 0.0 < deviation < math.inf else _MAX_DECIMALS + 1
        if decimals > _MAX_DECIMALS:
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
    """One friction element with what is known about each of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS, without the viscous exponent where it is 1; those of a part by names
            such as bristles.break_away.
        sources: the bags each parameter rests on.
        given_bristles: whether its bristles are those of the fallback, of another kind than LuGre's, as its c0 is.
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
            element: its own bristles, if it has any, were identified, and stay.
            estimates: of it.
            sources: of the estimates.
            fallback: where values that are not identifiable come from; None without one, or where LuGre's are told.
        """
        part = None if fallback is None else fallback.bristles
        if part is None or element.bristles is not None or ("c0" in estimates and estimates["c0"].identifiable):
            return cls(element, dict(estimates), sources)
        unknown = ParameterEstimate.unknown("it goes with c0, which is not identified")
        numbers = {f"{part.name}.{name}": unknown for name in part.numbers()}
        return cls(replace(element, bristles=part), {**estimates, **numbers}, sources, given_bristles=True)

    def value(self, name: str) -> float:
        """Return what the element has under the name of an estimate."""
        part, _, key = name.rpartition(".")
        return float(self.element.parts[part].numbers()[key] if part else getattr(self.element, name))
