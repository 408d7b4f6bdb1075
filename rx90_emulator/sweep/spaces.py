"""Where the values of a parameter come from: a list, or a distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from rx90_common.base.errors import ConfigError
from rx90_emulator.loop.catalogue import Value

MOST_VALUES = 1_000_000
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Values:
    """The values of a grid's parameter, in their order.

    Raises:
        ConfigError: if there are none, one is not finite, or one stands twice.
    """

    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        if not self.values:
            raise ConfigError("the list of values is empty; accepted: at least one value")
        for value in self.values:
            if not math.isfinite(value):
                raise ConfigError(f"a value is {value}; accepted: finite numbers, or true and false")
        if len(set(self.values)) < len(self.values):
            twice = next(v for v in self.values if self.values.count(v) > 1)
            raise ConfigError(f"the value {twice} stands twice; accepted: each value once")

    @classmethod
    def linspace(cls, start: float, stop: float, count: float) -> Values:
        """Return evenly spaced values, both ends included."""
        return cls(tuple(np.linspace(start, stop, _count(count)).tolist()))

    @classmethod
    def geomspace(cls, start: float, stop: float, count: float) -> Values:
        """Return values with a constant ratio, both ends included."""
        if not (start > 0.0 and stop > 0.0):
            raise ConfigError(f"geomspace from {start:g} to {stop:g}; accepted: both > 0")
        return cls(tuple(np.geomspace(start, stop, _count(count)).tolist()))


def _count(count: float) -> int:
    if count != int(count) or not 1 <= count <= MOST_VALUES:
        raise ConfigError(f"the count of values is {count:g}; accepted: a whole number in [1, {MOST_VALUES}]")
    return int(count)


@dataclass(frozen=True)
class Uniform:
    """Every value between the bounds is as likely."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)
        _check_finite(self.low, self.high)

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        return min(self.high, self.low + share * (self.high - self.low))


@dataclass(frozen=True)
class LogUniform:
    """The logarithm is uniform."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)
        _check_finite(self.low, self.high)
        if self.low <= 0.0:
            raise ConfigError(f"loguniform from {self.low:g}; accepted: a lower bound > 0")

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        return min(self.high, self.low * math.exp(share * math.log(self.high / self.low)))


@dataclass(frozen=True)
class Normal:
    """A normal distribution cut off at the bounds.

    Raises:
        ConfigError: also if the bounds leave less than 0.1 % of it: there it is no longer computed exactly.
    """

    mean: float
    deviation: float
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        _check_finite(self.mean, self.deviation)
        if self.deviation <= 0.0:
            raise ConfigError(f"deviation is {self.deviation:g}; accepted: a number > 0")
        _check_bounds(self.low, self.high)
        first, last = self._ends()
        if last - first < _LEAST_SHARE:
            raise ConfigError(
                f"the bounds {self.low:g} and {self.high:g} leave {last - first:.2g} of the normal "
                f"distribution ({self.mean:g}, {self.deviation:g}); accepted: at least {_LEAST_SHARE:g}"
            )

    def _ends(self) -> tuple[float, float]:
        low, high = ((bound - self.mean) / self.deviation for bound in (self.low, self.high))
        return float(ndtr(low)), float(ndtr(high))

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        first, last = self._ends()
        value = self.mean + self.deviation * float(ndtri(first + share * (last - first)))
        return min(self.high, max(self.low, value))


Distribution = Uniform | LogUniform | Normal


def _check_finite(*values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise ConfigError(f"a distribution has the value {value}; accepted: finite numbers")


def _check_bounds(low: float, high: float) -> None:
    if not low < high:
        raise ConfigError(f"the bounds are {low:g} and {high:g}; accepted: a lower one below the higher one")
