"""Goodness of the sliding fit, element by element, in figures and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.sliding.drift import FALSE_ALARMS, Drift
from rx90_emulator.identification.sliding.misfit import Misfit

_BANDS = 6
"""Bands of speed, as wide as each other in the logarithm, by which residuals are told."""


@dataclass(frozen=True, eq=False)
class FitQuality:
    """How well one element's curve fits its plateaus.

    Attributes:
        rms: of the plateaus' residual torque, Nm.
        share: of it in the RMS friction torque.
        chi2: sum of the squared residuals over those of the blocks' noise, for each degree of freedom; 1 where nothing
            but that noise is left.
        bands: slowest and fastest speed, rad/s, mean residual along the motion, and its standard deviation by the
            scatter of the plateaus, Nm, number of plateaus; shape (k, 5).
        agreement: of residuals at neighbouring speeds, in standard deviations.
        misfit: whether that is no accident.
        widening: largest factor on a deviation because of it.
        drift: change of the friction torque over the series, Nm; NaN where too few plateaus tell.
        drift_deviation: its standard deviation, Nm.
        drift_share: of the drift in the RMS friction torque.
        drifts: whether it is no accident.
        seconds: of the series, s.
    """

    rms: float
    share: float
    chi2: float
    bands: Array
    agreement: float
    misfit: bool
    widening: float
    drift: float
    drift_deviation: float
    drift_share: float
    drifts: bool
    seconds: float

    @classmethod
    def of(
        cls, element: int, velocity: Array, residual: Array, noise: Array, torque: Array, fits: tuple[Misfit, Drift]
    ) -> FitQuality:
        """Return the figures of one element.

        Args:
            element: its number.
            velocity: of its plateaus, rad/s, shape (p,); one or more.
            residual: measured less fitted torque, Nm, shape (p,).
            noise: standard deviation of each, by the scatter of blocks, Nm, shape (p,).
            torque: measured friction torque, Nm, shape (p,).
            fits: tests of the curves' form and of drift.
        """
        misfit, drift = fits
        free = max(1, len(residual) - misfit.widening.shape[1])
        usual = float(np.sqrt(np.mean(torque**2)))
        rms = float(np.sqrt(np.mean(residual**2)))
        size = float(drift.size[element])
        return cls(
            rms=rms,
            share=rms / usual if usual > 0.0 else math.nan,
            chi2=float(np.sum((residual / np.maximum(noise, 1e-12)) ** 2)) / free,
            bands=_bands(np.abs(velocity), np.sign(velocity) * residual),
            agreement=float(misfit.agreement[element]),
            misfit=bool(misfit.significant[element]),
            widening=float(np.sqrt(misfit.widening[element].max())),
            drift=size,
            drift_deviation=float(drift.deviation[element]),
            drift_share=size / usual if usual > 0.0 else math.nan,
            drifts=bool(drift.significant[element]),
            seconds=float(drift.seconds[element]),
        )

    def lines(self, name: str) -> list[str]:
        """Return it in words: how well the curve fits, and drift where there is some.

        Args:
            name: of the element.
        """
        text = f"fit of {name}: residual {self.rms:.3g} Nm RMS, {self.share:.2%} of its friction, chi2 {self.chi2:.3g}"
        text += " per degree of freedom"
        if self.misfit:
            by_speed = ", ".join(f"{low:.3g}-{high:.3g}: {mean:+.2g}" for low, high, mean, _, _ in self.bands.tolist())
            text += (
                f"; the curve does NOT FIT: residuals at neighbouring speeds agree by {self.agreement:.1f} standard "
                f"deviations, which makes deviations up to {self.widening:.1f} times wider; residual by speed, Nm at "
                f"rad/s: {by_speed}"
            )
        return [text, *([f"drift of {name}: {self.drift_text}"] if self.drifts else [])]

    @property
    def content(self) -> dict[str, Any]:
        """Return the figures as plain data."""
        found: dict[str, Any] = {
            "rms": _digits(self.rms),
            "share": _digits(self.share),
            "chi2_per_degree_of_freedom": _digits(self.chi2),
            "misfit": self.misfit,
            "residual_by_speed": [[_digits(value) for value in band[:3]] for band in self.bands.tolist()],
        }
        if not math.isnan(self.drift):
            found["drift"] = {
                "size": _digits(self.drift),
                "deviation": _digits(self.drift_deviation),
                "seconds": _digits(self.seconds),
                "significant": self.drifts,
            }
        return found

    @property
    def drift_text(self) -> str:
        """Return how large the drift is."""
        if math.isnan(self.drift):
            return "unknown: too few stretches"
        said = "significant" if self.drifts else "not significant"
        return (
            f"{self.drift:+.3g} +- {self.drift_deviation:.2g} Nm ({self.drift_share:+.1%} of its friction) in "
            f"{self.seconds:.4g} s, {said} (false alarms: {FALSE_ALARMS:.0%} of series; bags by their stamps or, where "
            "these overlap, as they are given)"
        )


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _bands(speed: Array, along: Array) -> Array:
    """Return bands of speed with mean residual, its deviation and the number of plateaus, shape (k, 5)."""
    place = np.log(speed)
    width = max(float(np.ptp(place)), 1e-9) / _BANDS
    number = np.minimum(((place - place.min()) / width).astype(np.int64), _BANDS - 1)
    rows = []
    for k in np.unique(number).tolist():
        mine = along[number == k]
        scatter = float(mine.std(ddof=1)) / math.sqrt(len(mine)) if len(mine) > 1 else math.nan
        inside = speed[number == k]
        rows.append((float(inside.min()), float(inside.max()), float(mine.mean()), scatter, float(len(mine))))
    return np.array(rows)
