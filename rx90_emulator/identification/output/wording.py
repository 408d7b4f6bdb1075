"""Estimates as text, with as many digits as their deviation leaves."""

from __future__ import annotations

import math

from rx90_emulator.identification.estimate import Estimate

_MOST_DECIMALS = 7


def value_and_deviation(estimate: Estimate) -> tuple[str, str]:
    """Return both with the decimals of the deviation's two leading digits: 28.03 and 0.10."""
    value, deviation = estimate.value, estimate.deviation
    if not 0.0 < deviation < math.inf:
        return f"{value:.4g}", f"{deviation:.2g}"
    decimals = 1 - math.floor(math.log10(deviation))
    if decimals > _MOST_DECIMALS:
        return f"{value:.4g}", f"{deviation:.2g}"
    shown = max(0, decimals)
    return f"{round(value, decimals):.{shown}f}", f"{round(deviation, decimals):.{shown}f}"
