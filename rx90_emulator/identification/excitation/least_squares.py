"""Weighted, robust least squares, with or without instruments, and deviations that hold under misfit.

Every linear fit of excitation runs is one call of `solve`: the base fit, drive gains, load parts, exponents that are
left open, parts that may be there, load dependence.

Residuals of an excitation run are no white noise: what the model leaves out (ripple, load, temperature) returns with
the motion. A fit is seen here as the sum of what every instant contributes to it, its influence: inverse curvature
times score, all joints of an instant together. Its variance follows from these contributions and their correlation in
time alone, whatever the residuals are. Repetitions of a motion count as one (`problem.phases`): their contributions are
added before they are squared.

The residuals of a fit are smaller than the errors that they stand for, and most of all at the low frequencies that its
columns consist of. Each block of time is therefore judged by the fit to all other blocks (as in the jackknife of Bell
and McCaffrey 2002, there for clusters); without that, 95 % intervals of random arms hold 91 to 93 % of the true values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq
from scipy.signal import fftconvolve

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Prior

_MAX_ROUNDS = 30
_CONVERGED = 1e-2  # change of a value in its deviations; what is left to change is some three times as much
_HUBER = 1.345  # deviations beyond which a residual weighs less: 95 % efficient for normal noise
_MIN_SINGULAR_VALUE = 1e-6  # singular value of scaled columns over the largest, below which a direction is unknown
_MAX_NULL_SHARE = 1e-6  # of such a direction's square in a parameter, from which on that is not determined


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Parameters that are linear in the torque.

    Attributes:
        value: shape (q,); where the rows do not determine it, the shortest solution.
        covariance: of the values, shape (q, q): autocorrelation-consistent, residuals of each block of time from the
            fit to the others; infinite on the diagonal of what is not determined.
        residual: torque less what the fit predicts, Nm, shape (r,).
        sigma: standard deviation of each joint's residuals by which its rows are weighted, Nm, shape (n,).
        weights: robust weights between 0 and 1, shape (r,).
        determined: whether the rows determine each parameter, shape (q,).
        influence: each motion's influences on the values, shape (k, q): see `covariance`.
    """

    value: Array
    covariance: Array
    residual: Array
    sigma: Array
    weights: Array
    determined: Mask
    influence: tuple[Array, ...]

    @property
    def deviation(self) -> Array:
        """Return standard deviations, shape (q,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def solve(
    problem: ExcitationProblem,
    columns: Array,
    torque: Array | None = None,
    *,
    prior: Prior | None = None,
    instruments: Array | None = None,
) -> LinearFit:
    """Fit a torque by columns, each joint weighted by its own residuals; rows far off weigh less (Huber).

    Solved is instruments^T W (torque - columns @ value) + precision (mean - value) = 0.

    Args:
        problem: r rows of n joints.
        columns: shape (r, q).
        torque: to explain, Nm, shape (r,); by default that of the problem.
        prior: of the first of the q parameters.
        instruments: shape (r, q): columns that share the motion with `columns`, but not their noise. By default the
            columns themselves: least squares.
    """
    target = problem.torque if torque is None else torque
    instruments = columns if instruments is None else instruments
    joints = [np.flatnonzero(problem.joint == joint) for joint in range(len(problem.arm.names))]
    own_columns = [columns[rows] for rows in joints]
    precision, known = np.zeros((columns.shape[1],) * 2), np.zeros(columns.shape[1])
    if prior is not None:
        count = len(prior.value)
        precision[:count, :count], known[:count] = prior.precision, prior.precision @ prior.value

    def solved(weights: Array) -> tuple[Array, Array, Mask, Array]:
        """Return values, the inverse of the equations' derivative, what is determined, and the joints' leverages.

        Directions that the rows do not determine stay 0.
        """
        weighted = instruments * weights[:, None]
        # Of each joint by itself: its part tells its rows' leverages without a product of all rows with the inverse.
        parts = [weighted[rows].T @ own for rows, own in zip(joints, own_columns, strict=True)]
        gram = np.sum(parts, axis=0) + precision
        scale = np.sqrt(np.abs(np.diag(gram)))
        scale[scale == 0.0] = 1.0
        left, values, directions = np.linalg.svd(gram / np.outer(scale, scale))
        there = values > _MIN_SINGULAR_VALUE**2 * values[0]
        inverse = (directions[there].T / values[there]) @ left[:, there].T / np.outer(scale, scale)
        determined = (directions[~there] ** 2).sum(axis=0) < _MAX_NULL_SHARE
        leverage = [np.sum(inverse * part.T) / max(len(rows), 1) for part, rows in zip(parts, joints, strict=True)]
        return inverse @ (weighted.T @ target + known), inverse, determined, np.array(leverage)

    sigma = np.full(len(joints), max(float(np.std(target)), 1e-12))
    floor = max(1e-9 * float(np.abs(problem.torque).max()), 1e-12)  # keeps the weights of data without noise finite
    weights = np.ones(len(target))
    value, inverse, determined, leverage = solved(weights / sigma[problem.joint] ** 2)
    for _ in range(_MAX_ROUNDS):
        before, residual = value, target - columns @ value
        for joint, rows in enumerate(joints):
            if len(rows):
                size = 1.4826 * np.median(np.abs(residual[rows]))
                sigma[joint] = max(float(size) / np.sqrt(max(1.0 - float(leverage[joint]), 0.05)), floor)
        weights = np.minimum(1.0, _HUBER * sigma[problem.joint] / np.maximum(np.abs(residual), 1e-300))
        value, inverse, determined, leverage = solved(weights / sigma[problem.joint] ** 2)
        deviation = np.sqrt(np.maximum(np.abs(np.diag(inverse)), 1e-300))
        if np.max(np.abs(value - before) / deviation, initial=0.0) < _CONVERGED:
            break
    residual, per_row = target - columns @ value, 1.0 / sigma[problem.joint] ** 2
    weighted = instruments * (per_row * weights)[:, None]
    outside = outside_residuals(columns, weighted, residual, time_blocks(problem))
    # Huber's criterion is quadratic where the weight is 1 and straight beyond.
    curvature = solved(per_row * (weights == 1.0))[1]
    influence = _influence_by_time(problem, (weighted * outside[:, None]) @ curvature.T)
    # What all rows share is no noise: it moves the values as it moves the torque.
    shared = inverse @ (weighted.T @ problem.uncertain)
    covariance = hac(influence) + curvature @ precision @ curvature.T + shared @ shared.T
    covariance[~determined, ~determined] = np.inf
    return LinearFit(value, covariance, residual, sigma, weights, determined, influence)


_MIN_BANDWIDTH = 2.0  # bandwidth of the kernel in instants, at least
_MAX_BANDWIDTH_SHARE = 0.25  # share of a run that it takes, at most
_TIME_BLOCKS = 20  # of time, about, of all runs together
_MIN_RUN_BLOCKS = 4  # of a run
_MAX_AUTOCORRELATION = 0.97  # first-order autocorrelation: above, a series has no finite bandwidth


def time_blocks(problem: ExcitationProblem) -> Index:
    """Return the number of each row's block of time, shape (r,): some twenty; repetitions of a motion share theirs."""
    lengths = problem.motion_lengths
    counts = np.maximum(_MIN_RUN_BLOCKS, np.round(_TIME_BLOCKS * lengths / lengths.sum()).astype(np.intp))
    first = np.cumsum(counts) - counts
    motion = problem.motion
    return np.asarray(first[motion] + problem.phase * counts[motion] // lengths[motion])


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
        outside[rows] += columns[rows] @ lstsq(without, instruments[rows].T @ residual[rows], cond=1e-12)[0]
    return outside


def _influence_by_time(problem: ExcitationProblem, influence: Array) -> tuple[Array, ...]:
    """Return for each motion the rows' influences, shape (r, q), instant by instant, repetitions added: (k, q) each."""
    ends = np.cumsum(problem.motion_lengths)
    whole = np.zeros((ends[-1], influence.shape[1]))
    np.add.at(whole, (ends - problem.motion_lengths)[problem.motion] + problem.phase, influence)
    return tuple(np.split(whole, ends[:-1]))


def hac(series: Sequence[Array]) -> Array:
    """Return the heteroscedasticity- and autocorrelation-consistent covariance of sums of influences, shape (q, q).

    Quadratic spectral kernel (Andrews 1991, equation 2.7); instants of different motions are independent. The bandwidth
    is that of his equations 6.2 and 6.4, with a first-order autoregression of each parameter's series, each parameter
    counting alike.

    Args:
        series: of each motion, shape (k, q).
    """
    lagged = np.sum([np.sum(values[1:] * values[:-1], axis=0) for values in series], axis=0)
    power = np.sum([np.sum(values**2, axis=0) for values in series], axis=0)
    known, width = power > 0.0, _MIN_BANDWIDTH
    if known.any():
        rho = np.clip(lagged[known] / power[known], -_MAX_AUTOCORRELATION, _MAX_AUTOCORRELATION)
        curvature = float(np.sum(4.0 * rho**2 / (1.0 - rho) ** 8) / np.sum(1.0 / (1.0 - rho) ** 4))
        width = 1.3221 * float((curvature * sum(len(values) for values in series)) ** 0.2)
        width = max(_MIN_BANDWIDTH, min(width, _MAX_BANDWIDTH_SHARE * max(len(values) for values in series)))
    total = np.zeros((series[0].shape[1],) * 2)
    for values in series:
        if len(values):
            lag = np.arange(-len(values) + 1, len(values)) / width
            angle = 1.2 * math.pi * np.where(lag == 0.0, 1.0, lag)
            kernel = np.where(lag == 0.0, 1.0, 3.0 / angle**2 * (np.sin(angle) / angle - np.cos(angle)))
            total += values.T @ fftconvolve(values, kernel[:, None], mode="same", axes=0)
    return np.asarray(0.5 * (total + total.T))
