"""Main effects of the parameters of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array

_MOST_LEVELS = 12  # different values that are levels by themselves; more are put into bins
_BINS = 8


class SweptColumn(NamedTuple):
    """A swept parameter: name of its column, unit, what it sets, and value of each run, (runs,), NaN if not set."""

    name: str
    unit: str
    meaning: str
    values: Array


@dataclass(frozen=True, eq=False)
class MainEffect:
    """Means of a metric over the runs that share a value of a parameter, or lie in one part of its range.

    Attributes:
        column: the parameter.
        levels: mean value of the parameter at each level, increasing, (levels,).
        means: mean of the metric there, (levels,).
        runs: number of runs that set the parameter.
        share: of the metric's variance over these runs that the levels explain, adjusted for their number (epsilon
            squared; Kelley 1935); 0 where chance alone would explain as much, NaN with one level.
    """

    column: SweptColumn
    levels: Array
    means: Array
    runs: int
    share: float


def main_effect(column: SweptColumn, metric: Array) -> MainEffect:
    """Return the main effect of a parameter on a metric, (runs,), NaN where a run failed."""
    known = np.isfinite(column.values) & np.isfinite(metric)
    x = column.values[known]
    y = metric[known]
    distinct = np.unique(x)
    if len(distinct) <= _MOST_LEVELS:
        level = np.searchsorted(distinct, x)
    else:
        level = np.searchsorted(np.quantile(x, np.arange(1, _BINS) / _BINS), x, side="right")
    _, level, counts = np.unique(level, return_inverse=True, return_counts=True)
    levels = np.bincount(level, weights=x) / counts
    means = np.bincount(level, weights=y) / counts
    within = float(np.sum((y - means[level]) ** 2))
    total = float(np.sum((y - y.mean()) ** 2)) if len(y) else 0.0
    share = np.nan
    if len(counts) > 1:
        # With one run at each level there is nothing to tell their scatter from the effect.
        scatter = within * (len(y) - 1) / (len(y) - len(counts)) if len(y) > len(counts) else 0.0
        share = max(0.0, 1.0 - scatter / total) if total else 0.0
    return MainEffect(column, levels, means, len(y), share)
