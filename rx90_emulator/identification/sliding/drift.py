"""Drift of the friction within a series, as by temperature: a trend test that knows of autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.sliding.residuals import Residuals

FALSE_ALARMS = 0.01
"""Probability that drift is claimed in a series without any, of all elements together."""
_LEAST_PLATEAUS = 12


@dataclass(frozen=True, eq=False)
class Drift:
    """Change of the elements' friction torque along their motion, from the beginning of a series to its end.

    Attributes:
        size: Nm, shape (n_el,); NaN where too few plateaus tell.
        deviation: standard deviation, with the first autocorrelation of the plateaus, Nm, shape (n_el,).
        significant: whether it is no accident, shape (n_el,).
        seconds: from the first to the last plateau of the element, s, shape (n_el,).
    """

    size: Array
    deviation: Array
    significant: Mask
    seconds: Array

    @classmethod
    def of(cls, residuals: Residuals, free: Mask) -> Drift:
        """Test the residuals of a fit for a trend.

        Args:
            residuals: of the fit.
            free: which parameters of the elements were fitted, shape (n_el, p).
        """
        elements = len(free)
        size, deviation, seconds = (np.full(elements, np.nan) for _ in range(3))
        significant = np.zeros(elements, dtype=np.bool_)
        fitted = np.flatnonzero(free.any(axis=1))
        basis = np.linalg.qr(residuals.slope)[0]
        quantile = 1.0 - 0.5 * FALSE_ALARMS / max(1, len(fitted))
        for e in fitted.tolist():
            mine = np.flatnonzero(residuals.velocity[:, e])
            time = residuals.time[mine]
            count, span = len(mine), float(np.ptp(time))
            if count < max(_LEAST_PLATEAUS, 2 * int(free[e].sum())) or span == 0.0:
                continue
            at = (residuals.time - time.mean()) / span
            trend = residuals.gain[:, e] * at[residuals.plateau]
            trend = trend - basis @ (basis.T @ trend)
            power = float(trend @ trend)
            if power < 1e-9:
                continue
            size[e], seconds[e] = trend @ residuals.left / power, span
            left = residuals.left - size[e] * trend
            weight = np.zeros((2, len(residuals.time)))
            np.add.at(weight[0], residuals.plateau, residuals.gain[:, e] * left)
            np.add.at(weight[1], residuals.plateau, residuals.gain[:, e] ** 2)
            order = mine[np.argsort(time, kind="stable")]
            repeated = _repeated(weight[0, order] / np.sqrt(np.maximum(weight[1, order], 1e-300)))
            worth = count * (1.0 - repeated) / (1.0 + repeated)
            freedom = max(1.0, worth - 1.0 - int(free[e].sum()) / 2.0)
            variance = float(np.sum(weight[0, mine] ** 2 / np.maximum(weight[1, mine], 1e-300))) / count
            deviation[e] = np.sqrt(max(variance, 1.0) * count / freedom / power)
            critical = float(stdtrit(freedom, quantile))
            significant[e] = abs(size[e]) > critical * deviation[e]
        return cls(size, deviation, significant, seconds)


def _repeated(residual: Array) -> float:
    """Return the first autocorrelation; what a fitted level and trend take from it is given back (Kendall 1954)."""
    count = len(residual)
    found = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)
    return min(max((count * found + 2.0) / (count - 4), 0.0), 0.95)
