"""Deviations of a fit that hold although its residuals are correlated in time, unequal in size, and a misfit's.

Residuals of an excitation run are no white noise: what the model leaves out (ripple, load, temperature) returns with
the motion. A fit is seen here as the sum of what every instant contributes to it, its influence: inverse curvature
times score, all joints of an instant together. Its variance follows from these contributions and their correlation in
time alone, whatever the residuals are. Repetitions of a motion count as one (`repetition`): their contributions are
added before they are squared.

The residuals of a fit are smaller than the errors that they stand for, and most of all at the low frequencies that its
columns consist of. Each block of time is therefore judged by the fit to all other blocks (as in the jackknife of Bell
and McCaffrey 2002, there for clusters); without that, 95 % intervals of random arms hold 91 to 93 % of the true values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import lstsq
from scipy.signal import fftconvolve

from rx90_common.base.arrays import Array, Index
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_NARROWEST = 2.0  # bandwidth of the kernel in instants, at least
_WIDEST = 0.25  # share of a run that it takes, at most
_BLOCKS = 20  # of time, about, of all runs together
_FEWEST = 4  # of a run
_STEEPEST = 0.97  # first-order autocorrelation: above, a series has no finite bandwidth


def time_blocks(problem: ExcitationProblem) -> Index:
    """Return the number of each row's block of time, shape (r,): some twenty; repetitions of a motion share theirs."""
    lengths = _lengths(problem)
    counts = [max(_FEWEST, round(_BLOCKS * length / sum(lengths))) for length in lengths]
    first = np.cumsum([0, *counts])
    block = np.zeros(len(problem), dtype=np.intp)
    for run, (motion, phase) in enumerate(problem.phases):
        rows = problem.run == run
        block[rows] = first[motion] + phase[problem.place[rows]] * counts[motion] // lengths[motion]
    return block


def _lengths(problem: ExcitationProblem) -> list[int]:
    """Return how many phases each motion has."""
    lengths = [1] * (1 + max(motion for motion, _ in problem.phases))
    for motion, phase in problem.phases:
        lengths[motion] = max(lengths[motion], int(phase.max(initial=0)) + 1)
    return lengths


def outside_residuals(columns: Array, instruments: Array, residual: Array, block: Index) -> Array:
    """Return residuals of each block of rows from the fit to all other blocks, shape (r,).

    The equations of the fit are instruments^T (target - columns @ value) = 0.

    Args:
        columns: shape (r, q).
        instruments: weighted columns for least squares, shape (r, q).
        residual: of the fit to all rows, shape (r,).
        block: number of each row's block, shape (r,).
    """
    whole = instruments.T @ columns
    outside = residual.copy()
    for number in np.unique(block).tolist():
        rows = block == number
        without = whole - instruments[rows].T @ columns[rows]
        moved = lstsq(without, instruments[rows].T @ residual[rows], cond=1e-12)[0]
        outside[rows] += columns[rows] @ moved
    return outside


def influence_by_time(problem: ExcitationProblem, scores: Array, inverse: Array) -> list[Array]:
    """Return each motion's influences on the parameters, instant by instant, repetitions added.

    Args:
        problem: r rows.
        scores: what each row adds to the equations of the fit, shape (r, q).
        inverse: of the derivative of these equations by the parameters, shape (q, q).

    Returns:
        For each motion an array of shape (k, q), 0 where all rows of an instant are left out.
    """
    influence = scores @ inverse.T
    result = [np.zeros((length, influence.shape[1])) for length in _lengths(problem)]
    for run, (motion, phase) in enumerate(problem.phases):
        rows = problem.run == run
        np.add.at(result[motion], phase[problem.place[rows]], influence[rows])
    return result


def hac(series: Sequence[Array]) -> Array:
    """Return the heteroscedasticity- and autocorrelation-consistent covariance of sums of influences, shape (q, q).

    Quadratic spectral kernel (Andrews 1991, equation 2.7) with the bandwidth that `bandwidth` chooses; instants of
    different motions are independent.
    """
    width = bandwidth(series)
    total = np.zeros((series[0].shape[1],) * 2)
    for values in series:
        if len(values):
            kernel = quadratic_spectral(np.arange(-len(values) + 1, len(values)) / width)
            total += values.T @ fftconvolve(values, kernel[:, None], mode="same", axes=0)
    return np.asarray(0.5 * (total + total.T))


def bandwidth(series: Sequence[Array]) -> float:
    """Return Andrews' bandwidth of the quadratic spectral kernel, in instants.

    His equations 6.2 and 6.4 with a first-order autoregression of each parameter's series; each parameter counts alike.
    """
    lagged = np.sum([np.sum(values[1:] * values[:-1], axis=0) for values in series], axis=0)
    power = np.sum([np.sum(values**2, axis=0) for values in series], axis=0)
    known = power > 0.0
    if not known.any():
        return _NARROWEST
    rho = np.clip(lagged[known] / power[known], -_STEEPEST, _STEEPEST)
    curvature = float(np.sum(4.0 * rho**2 / (1.0 - rho) ** 8) / np.sum(1.0 / (1.0 - rho) ** 4))
    width = 1.3221 * float((curvature * sum(len(values) for values in series)) ** 0.2)
    longest = max(len(values) for values in series)
    return max(_NARROWEST, min(width, _WIDEST * longest))


def quadratic_spectral(lag: Array) -> Array:
    """Return the quadratic spectral kernel at lags over the bandwidth; 1 at 0."""
    angle = 1.2 * math.pi * np.where(lag == 0.0, 1.0, lag)
    value = 3.0 / angle**2 * (np.sin(angle) / angle - np.cos(angle))
    return np.asarray(np.where(lag == 0.0, 1.0, value))
