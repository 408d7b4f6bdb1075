"""Goodness of fit of the sliding curves: misfit over the speeds, drift over the series.

The random effect treats the errors common to the blocks of a plateau as random. If a curve of the model's form does not
go through the data, the errors of plateaus at neighbouring speeds have one sign, and the errors of the estimates are
larger than with independent errors. Leaving out bands of speeds in turn shows by how much. Drift of the friction, for
example by temperature, is a trend of the residuals over the series; its test accounts for their autocorrelation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.estimates import cluster_variances, digits

FALSE_ALARMS = 0.01
"""Probability of reporting drift in a series without any, for all elements together."""
MISFIT_SD = 3.0
"""Standard deviations of the sum of products of neighbouring residuals, above which a curve does not fit."""
_CORRELATION_LENGTH = 1.0  # of ln |speed| over which errors are correlated: a factor of e
_MIN_LOG_SPEED_DISTANCE = 0.1
"""Of ln |speed|. Residuals that are closer may agree because of the ripple at one speed, which has its own factor."""
_BAND_WIDTH = 1.0  # of ln |speed|, within which errors count as one
_MIN_RESIDUAL_LEVERAGE = 0.1  # lower bound of 1 - leverage of a band
_SCATTER_NEIGHBOURS = 4  # residuals on either side from which the scatter is estimated
_RANK_CUTOFF = 1e-10  # of the largest singular value: smaller ones are rounding
_MIN_PLATEAUS = 12  # for a test of drift
_BANDS = 6  # bands of speed, of equal logarithmic width, by which residuals are reported


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of r equations of unit noise, in c plateaus.

    Attributes:
        residual: shape (r,).
        slope: derivatives by the q free parameters, nuisance parameters eliminated, shape (r, q).
        gain: of the elements' torques along their motion, nuisance parameters eliminated, shape (r, n_el).
        plateau: number of each equation's plateau, 0 to c - 1, shape (r,).
        velocity: of the elements, 0 where they do not slide, rad/s, shape (c, n_el).
        along: residual torque of each element along its motion, standard deviation 1, shape (c, n_el).
        time: s, shape (c,).
    """

    residual: Array
    slope: Array
    gain: Array
    plateau: NDArray[np.int64]
    velocity: Array
    along: Array
    time: Array


def misfits_of(residuals: Residuals, free: Mask, covariance: Array) -> tuple[Array, Array]:
    """Return the misfit of each element's curve by the residuals of a fit.

    The first result is the correlation of residuals at neighbouring speeds, in standard deviations for independent
    residuals; above MISFIT_SD it is a misfit, shape (n_el,). The second is the factor on the variance of each parameter
    due to the misfit, 1 without one, shape (n_el, p).

    Args:
        residuals: of the fit.
        free: which parameters of the elements were fitted, shape (n_el, p).
        covariance: of the free parameters with independent plateaus, shape (q, q).
    """
    agreement = np.zeros(len(free))
    widening = np.ones(free.shape)
    column = np.cumsum(free.ravel()).reshape(free.shape) - 1
    for e, own in enumerate(free):
        own_rows = np.flatnonzero(residuals.velocity[:, e]) if own.any() else np.zeros(0, dtype=np.int64)
        if len(own_rows):
            speed = np.log(np.abs(residuals.velocity[own_rows, e]))
            along = residuals.along[own_rows, e]
            distance = np.abs(speed[:, None] - speed)
            along = along / _scatter(along, np.argsort(speed))
            kernel = np.triu(
                np.maximum(0.0, 1.0 - distance / _CORRELATION_LENGTH) * (distance > _MIN_LOG_SPEED_DISTANCE), 1
            )
            spread = float(np.sqrt(along**2 @ kernel**2 @ along**2))
            agreement[e] = float(along @ kernel @ along) / spread if spread > 0.0 else 0.0
            if agreement[e] > MISFIT_SD:
                band = np.full(len(residuals.velocity), -1)
                band[own_rows] = np.floor((speed - speed.min()) / _BAND_WIDTH)
                values, vectors = np.linalg.eigh(covariance)
                root = vectors * np.sqrt(np.maximum(values, 0.0))
                bands = band[residuals.plateau]
                variance = cluster_variances(
                    residuals.slope, residuals.residual, bands, root, 1.0, _MIN_RESIDUAL_LEVERAGE
                )
                variance *= 1.0 - 1.0 / len(np.unique(band[own_rows]))
                chosen = column[e, own]
                widening[e, own] = np.maximum(1.0, variance[chosen] / np.diag(covariance)[chosen])
    return agreement, widening


def _scatter(residual: Array, order: NDArray[np.intp]) -> Array:
    """Return the standard deviation of each residual from differences to its neighbours, which have the same misfit."""
    if len(residual) < 3:
        return np.ones(len(residual))
    squares = np.diff(residual[order]) ** 2 / 2.0
    window = np.ones(min(2 * _SCATTER_NEIGHBOURS, len(squares)))
    usual = np.convolve(squares, window, "same") / np.convolve(np.ones(len(squares)), window, "same")
    local = np.empty(len(residual))
    local[order] = np.sqrt(np.maximum(np.append(usual, usual[-1]), 1e-6 * squares.mean() + 1e-300))
    return local


@dataclass(frozen=True)
class Drift:
    """Change of an element's friction torque along its motion, from the beginning of a series to its end.

    Attributes:
        size: Nm; NaN if there are too few plateaus.
        deviation: standard deviation, with the first autocorrelation of the plateaus, Nm.
        seconds: from the first to the last plateau of the element, s.
        significant: whether it is significant.
    """

    size: float = math.nan
    deviation: float = math.nan
    seconds: float = math.nan
    significant: bool = False


def drifts_of(residuals: Residuals, free: Mask) -> list[Drift]:
    """Test the residuals of a fit for a trend in each element, two-sided.

    Args:
        residuals: of the fit.
        free: which parameters of the elements were fitted, shape (n_el, p).
    """
    # Of the derivatives by all parameters, some of those of coupled elements may be dependent.
    size = np.linalg.norm(residuals.slope, axis=0)
    basis, values, _ = np.linalg.svd(residuals.slope / np.where(size > 0.0, size, 1.0), full_matrices=False)
    basis = basis[:, values > _RANK_CUTOFF * values.max(initial=0.0)]
    quantile = 1.0 - 0.5 * FALSE_ALARMS / max(1, int(free.any(axis=1).sum()))
    found = []
    for e, fitted in enumerate(free.sum(axis=1).tolist()):
        own_rows = np.flatnonzero(residuals.velocity[:, e])
        time = residuals.time[own_rows]
        gain = residuals.gain[:, e]
        plateau = residuals.plateau
        count = len(own_rows)
        span = float(np.ptp(time)) if len(own_rows) else 0.0
        power = 0.0
        if fitted and count >= max(_MIN_PLATEAUS, 2 * fitted) and span > 0.0:
            trend = gain * ((residuals.time - time.mean()) / span)[plateau]
            trend -= basis @ (basis.T @ trend)
            power = float(trend @ trend)
        if power < 1e-9:
            found.append(Drift())
            continue
        change = float(trend @ residuals.residual) / power
        residual = residuals.residual - change * trend
        pull = np.bincount(plateau, gain * residual, len(residuals.time))
        weight = np.bincount(plateau, gain**2, len(residuals.time))
        along = (pull / np.sqrt(np.maximum(weight, 1e-300)))[own_rows[np.argsort(time, kind="stable")]]
        # The fit of level and trend biases the first autocorrelation low, which is corrected (Kendall 1954).
        squares = float(along @ along)
        correlation = float(along[1:] @ along[:-1]) / max(squares, 1e-300)
        correlation = min(max((count * correlation + 2.0) / (count - 4), 0.0), 0.95)
        effective = count * (1.0 - correlation) / (1.0 + correlation)
        freedom = max(1.0, effective - 1.0 - fitted / 2.0)
        deviation = math.sqrt(max(squares / count, 1.0) * count / freedom / power)
        found.append(Drift(change, deviation, span, abs(change) > float(stdtrit(freedom, quantile)) * deviation))
    return found


@dataclass(frozen=True, eq=False)
class CurvePoints:
    """Measured and fitted friction torque of one element, one point for each of p plateaus.

    Attributes:
        velocity: rad/s, shape (p,).
        torque: measured torque less the rigid arm's and the other elements', Nm, shape (p,).
        deviation: standard deviation of its noise, Nm, shape (p,).
        fitted: torque by the identified parameters, Nm, shape (p,).
        time: in the series, s, shape (p,).
        line: the identified curve over the measured speeds, in either direction: velocity, torque, and the standard
            deviation of the torque due to the parameters, shape (3, k).
    """

    velocity: Array
    torque: Array
    deviation: Array
    fitted: Array
    time: Array
    line: Array


@dataclass(frozen=True, eq=False)
class FitQuality:
    """Goodness of fit of one element's curve.

    Attributes:
        rms: of the plateaus' residual torque, Nm.
        friction: RMS friction torque, Nm.
        chi2: sum of the squared residuals over those of the blocks' noise, for each degree of freedom; 1 for noise
            alone.
        bands: slowest and fastest speed, rad/s, mean residual along the motion, Nm; shape (k, 3).
        agreement: correlation of the residuals at neighbouring speeds, as in `misfits_of`.
        widening: largest factor on the deviation of a parameter due to a misfit, 1 without one.
        drift: of the friction torque over the series.
    """

    rms: float
    friction: float
    chi2: float
    bands: Array
    agreement: float
    widening: float
    drift: Drift

    @classmethod
    def of(cls, curve: CurvePoints, agreement: float, widening: Array, drift: Drift) -> FitQuality:
        """Return the figures of one element with one plateau or more."""
        residual = curve.torque - curve.fitted
        speed = np.abs(curve.velocity)
        rms = float(np.sqrt(np.mean(residual**2)))
        friction = float(np.sqrt(np.mean(curve.torque**2)))
        chi2 = float(np.sum((residual / np.maximum(curve.deviation, 1e-12)) ** 2))
        place = np.log(speed) - np.log(speed.min())
        along = np.sign(curve.velocity) * residual
        number = np.minimum((place / (max(float(np.ptp(place)), 1e-9) / _BANDS)).astype(np.int64), _BANDS - 1)
        inside = [number == k for k in np.unique(number).tolist()]
        bands = np.array([(speed[one].min(), speed[one].max(), along[one].mean()) for one in inside])
        freedom = max(1, len(residual) - len(widening))
        return cls(rms, friction, chi2 / freedom, bands, agreement, math.sqrt(float(widening.max())), drift)

    @property
    def misfit(self) -> bool:
        """Return whether the curve does not fit."""
        return self.agreement > MISFIT_SD

    @property
    def share(self) -> float:
        """Return the residual torque over the friction torque, RMS; NaN without friction."""
        return self.rms / self.friction if self.friction > 0.0 else math.nan

    def lines(self, name: str) -> list[str]:
        """Return lines for an element: the goodness of its fit, and a drift if there is one."""
        text = f"fit of {name}: residual {self.rms:.3g} Nm RMS, {self.share:.2%} of its friction, chi2 {self.chi2:.3g}"
        text += " per degree of freedom"
        if self.misfit:
            by_speed = ", ".join(f"{low:.3g}-{high:.3g}: {mean:+.2g}" for low, high, mean in self.bands.tolist())
            text += (
                f"; the curve does NOT FIT: residuals at neighbouring speeds agree by {self.agreement:.1f} "
                f"standard deviations, which makes deviations up to {self.widening:.1f} times wider; residual by "
                f"speed, Nm at rad/s: {by_speed}"
            )
        return [text, *([f"drift of {name}: {self.drift_text}"] if self.drift.significant else [])]

    @property
    def drift_text(self) -> str:
        """Return the size of the drift in words."""
        drift = self.drift
        share = self.drift.size / self.friction if self.friction > 0.0 else math.nan
        if math.isnan(drift.size):
            return "unknown: too few stretches"
        return (
            f"{drift.size:+.3g} +- {drift.deviation:.2g} Nm ({share:+.1%} of its friction) in {drift.seconds:.4g} s, "
            f"{'' if drift.significant else 'not '}significant (false alarms: {FALSE_ALARMS:.0%} of series; bags by "
            "their stamps or, where these overlap, as they are given)"
        )

    @property
    def content(self) -> dict[str, Any]:
        """Return the figures as plain data, to four digits."""
        found: dict[str, Any] = {
            "rms": digits(self.rms, 4),
            "share": digits(self.share, 4),
            "chi2_per_degree_of_freedom": digits(self.chi2, 4),
            "misfit": self.misfit,
            "residual_by_speed": [[digits(value, 4) for value in band] for band in self.bands.tolist()],
        }
        if not math.isnan(self.drift.size):
            drift = vars(self.drift)
            found["drift"] = {k: v if k == "significant" else digits(v, 4) for k, v in drift.items()}
        return found
