"""Deviations of a fit that hold although its residuals are correlated in time and unequal in size.

Residuals of an excitation run are no white noise: what the model leaves out (ripple, load, temperature) returns with
the motion. Both estimates here see the fit as the sum of what every instant contributes to it, its influence: inverse
curvature times score, all joints of an instant together.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import fftconvolve

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_FEWEST = 2.0  # instants of the kernel's bandwidth, at least
_LONGEST = 0.25  # share of a run that it takes, at most


def influence_by_time(problem: ExcitationProblem, scores: Array, curvature: Array) -> list[Array]:
    """Return each run's influences on the parameters, instant by instant.

    Args:
        problem: r rows.
        scores: gradient of each row's share in the criterion, shape (r, q).
        curvature: its second derivative, summed over the rows, shape (q, q).

    Returns:
        For each run an array of shape (k, q), 0 where all rows of an instant are left out.
    """
    influence = scores @ np.linalg.pinv(curvature, hermitian=True)
    result = []
    for number, run in enumerate(problem.runs):
        rows = problem.run == number
        series = np.zeros((len(run.rows), influence.shape[1]))
        np.add.at(series, problem.place[rows], influence[rows])
        result.append(series)
    return result


def hac(series: list[Array]) -> Array:
    """Return the heteroscedasticity- and autocorrelation-consistent covariance of sums of influences, shape (q, q).

    Quadratic spectral kernel with Andrews' bandwidth (1991, equations 6.2 and 6.4: a first-order autoregression
    of each series); instants of different runs are independent.
    """
    width = bandwidth(series)
    total = np.zeros((series[0].shape[1],) * 2)
    for values in series:
        lags = np.arange(-len(values) + 1, len(values))
        kernel = quadratic_spectral(lags / width)
        total += values.T @ fftconvolve(values, kernel[:, None], mode="same", axes=0) if len(values) else 0.0
    return np.asarray(0.5 * (total + total.T))


def bandwidth(series: list[Array]) -> float:
    """Return Andrews' bandwidth of the quadratic spectral kernel, in instants."""
    lagged = np.sum([np.sum(values[1:] * values[:-1], axis=0) for values in series], axis=0)
    power = np.sum([np.sum(values**2, axis=0) for values in series], axis=0)
    known = power > 0.0
    if not known.any():
        return _FEWEST
    rho = np.clip(lagged[known] / power[known], -0.97, 0.97)
    # Each parameter has the same weight in the sum: its series counts in units of its own deviation.
    above = float(np.sum(4.0 * rho**2 / (1.0 - rho) ** 8))
    below = float(np.sum(1.0 / (1.0 - rho) ** 4))
    count = sum(len(values) for values in series)
    width = 1.3221 * float(above / below * count) ** 0.2
    longest = max(len(values) for values in series)
    return float(max(_FEWEST, min(width, _LONGEST * longest)))


def quadratic_spectral(lag: Array) -> Array:
    """Return Andrews' quadratic spectral kernel at lags over the bandwidth; 1 at 0."""
    angle = 1.2 * math.pi * np.where(lag == 0.0, 1.0, lag)
    value = 25.0 / (12.0 * math.pi**2 * np.where(lag == 0.0, 1.0, lag) ** 2)
    return np.asarray(np.where(lag == 0.0, 1.0, value * (np.sin(angle) / angle - np.cos(angle))))
