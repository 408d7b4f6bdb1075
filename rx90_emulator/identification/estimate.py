"""Identified parameters with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.records.record import JointRecord

Array = NDArray[np.float64]

SLIDING = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "omega_s", "delta", "c2")
PRESLIDING = ("c0", "c1")
PARAMETERS = (*SLIDING, *PRESLIDING)


@dataclass(frozen=True)
class Source:
    """A bag that an estimate rests on."""

    path: Path
    sha256: str

    @classmethod
    def of(cls, record: JointRecord) -> Source:
        """Return the bag of a record."""
        return cls(record.source, record.sha256)


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        value: the estimate; NaN if the data cannot tell it.
        deviation: standard deviation, in the unit of the value; 0 for a value that was given, not estimated.
        identifiable: whether the data tell the value.
        reason: why they do not; empty if they do.
    """

    value: float
    deviation: float
    identifiable: bool = True
    reason: str = ""

    @classmethod
    def unknown(cls, reason: str) -> Estimate:
        """Return the estimate of a parameter that the data cannot tell."""
        return cls(math.nan, math.inf, False, reason)

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the confidence interval at 95 %."""
        return self.value - 1.96 * self.deviation, self.value + 1.96 * self.deviation


@dataclass(frozen=True, eq=False)
class ElementEstimate:
    """The parameters of one friction element.

    Attributes:
        element: its name.
        parameters: estimates by the names in PARAMETERS, or a part of them, in that order.
        correlation: of the estimates, in the order of `parameters`; NaN where one is not identifiable.
        sources: the bags they rest on.
    """

    element: str
    parameters: Mapping[str, Estimate]
    correlation: Array
    sources: tuple[Source, ...]

    def __post_init__(self) -> None:
        unknown = [name for name in self.parameters if name not in PARAMETERS]
        if unknown:
            raise IdentificationError(f"{self.element}: parameter {unknown[0]!r}; accepted: {', '.join(PARAMETERS)}")
        shape = (len(self.parameters), len(self.parameters))
        if self.correlation.shape != shape:
            raise IdentificationError(
                f"{self.element}: correlation of shape {self.correlation.shape}; accepted: {shape}"
            )

    def covariance(self) -> Array:
        """Return the covariance of the estimates, 0 for what is not identifiable, in the order of `parameters`."""
        deviation = np.array([e.deviation if e.identifiable else 0.0 for e in self.parameters.values()])
        return np.asarray(np.nan_to_num(self.correlation) * np.outer(deviation, deviation))
