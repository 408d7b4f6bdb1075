"""Drift of the friction within a series, as by temperature: a trend test that knows of autocorrelation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.sliding.residuals import Residuals

FALSE_ALARMS = 0.01
"""Probability that drift is claimed in a series without any, of all elements together."""
_LEAST_PLATEAUS = 12
_BANDWIDTH = 1.3  # lags over the root of the number of plateaus (Lazarus, Lewis, Stock and Watson 2018)
_FIXED_B = (1.0, 4.1618 / 2.3263, 0.5368 / 2.3263, -0.9060 / 2.3263)
"""Critical values for the Bartlett kernel with the share b of lags over those of the normal distribution, as a
polynomial of b (Kiefer and Vogelsang 2005, table 1, 99 %)."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Change of the elements' friction torque along their motion, from the beginning of a series to its end.

    Attributes:
        size: Nm, shape (n_el,); NaN where too few plateaus tell.
        deviation: standard deviation, by a HAC estimate with the Bartlett kernel, Nm, shape (n_el,).
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
        quantile = float(ndtri(1.0 - 0.5 * FALSE_ALARMS / max(1, len(fitted))))
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
            score = np.zeros(len(residuals.time))
            np.add.at(score, residuals.plateau, trend * (residuals.left - size[e] * trend))
            lags = min(count - 1, max(1, round(_BANDWIDTH * np.sqrt(count))))
            variance = _long_run(score[mine[np.argsort(time, kind="stable")]], lags)
            deviation[e] = np.sqrt(variance * count / (count - 1 - int(free[e].sum()))) / power
            critical = quantile * np.polynomial.polynomial.polyval(lags / count, _FIXED_B)
            significant[e] = abs(size[e]) > critical * deviation[e]
        return cls(size, deviation, significant, seconds)


def _long_run(scores: Array, lags: int) -> float:
    """Return the variance of the sum of a series of scores (Newey and West 1987)."""
    total = float(scores @ scores)
    for lag in range(1, lags):
        total += 2.0 * (1.0 - lag / lags) * float(scores[lag:] @ scores[:-lag])
    return total
