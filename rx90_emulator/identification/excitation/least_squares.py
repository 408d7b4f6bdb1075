"""Weighted, robust least squares, with or without instruments, and deviations that hold under misfit.

Deviations of a fit that hold although its residuals are correlated in time, unequal in size, and a misfit's.

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
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lstsq
from scipy.signal import fftconvolve

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.excitation.linear_parameters import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem

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

    @property
    def correlation(self) -> Array:
        """Return the correlation of the values, shape (q, q); NaN for what is not determined."""
        deviation = np.where(self.determined & (self.deviation > 0.0), self.deviation, np.nan)
        return np.asarray(self.covariance / np.outer(deviation, deviation))


def solve(
    problem: ExcitationProblem,
    columns: Array,
    torque: Array | None = None,
    *,
    robust: bool = True,
    prior: Prior | None = None,
    instruments: Array | None = None,
) -> LinearFit:
    """Fit a torque by columns, each joint weighted by its own residuals.

    Args:
        problem: r rows of n joints.
        columns: shape (r, q).
        torque: to explain, Nm, shape (r,); by default that of the problem.
        robust: whether rows far off weigh less (Huber); else all rows of a joint weigh the same.
        prior: of the first of the q parameters.
        instruments: shape (r, q): columns that share the motion with `columns`, but not their noise. By default the
            columns themselves: least squares.
    """
    target = problem.torque if torque is None else torque
    equations = _Equations(problem, columns, columns if instruments is None else instruments, target, prior)
    sigma = np.full(len(problem.arm.names), max(float(np.std(target)), 1e-12))
    weights = np.ones(len(target))
    solution = equations.solved(weights / sigma[problem.joint] ** 2)
    for _ in range(_MAX_ROUNDS):
        before = solution.value
        residual = target - columns @ before
        sigma = _sigma(problem, residual, solution.leverage, sigma, robust=robust)
        if robust:
            weights = np.minimum(1.0, _HUBER * sigma[problem.joint] / np.maximum(np.abs(residual), 1e-300))
        solution = equations.solved(weights / sigma[problem.joint] ** 2)
        size = np.sqrt(np.maximum(np.abs(np.diag(solution.inverse)), 1e-300))
        if np.max(np.abs(solution.value - before) / size, initial=0.0) < _CONVERGED:
            break
    residual = target - columns @ solution.value
    per_row = 1.0 / sigma[problem.joint] ** 2
    weighted = equations.instruments * (per_row * weights)[:, None]
    outside = outside_residuals(columns, weighted, residual, time_blocks(problem))
    # Huber's criterion is quadratic where the weight is 1 and straight beyond.
    curvature = equations.solved(per_row * (weights == 1.0)).inverse
    influence = influence_by_time(problem, weighted * outside[:, None], curvature)
    covariance = hac(influence)
    if equations.precision is not None:
        covariance += curvature @ equations.precision @ curvature.T
    # What all rows share is no noise: it moves the values as it moves the torque.
    shared = solution.inverse @ (weighted.T @ problem.uncertain)
    covariance += shared @ shared.T
    unknown = np.flatnonzero(~solution.determined)
    covariance[unknown, unknown] = np.inf
    return LinearFit(solution.value, covariance, residual, sigma, weights, solution.determined, tuple(influence))


def _sigma(problem: ExcitationProblem, residual: Array, leverage: Array, before: Array, *, robust: bool) -> Array:
    """Return the deviation of each joint's residuals, Nm; `leverage`, shape (n,), is what the fit took of squares."""
    sigma = before.copy()
    # A floor keeps the weights finite for data without noise.
    floor = max(1e-9 * float(np.abs(problem.torque).max()), 1e-12)
    for joint in np.unique(problem.joint).tolist():
        rows = problem.joint == joint
        left = max(1.0 - float(leverage[joint]), 0.05)
        size = 1.4826 * np.median(np.abs(residual[rows])) if robust else np.sqrt(np.mean(residual[rows] ** 2))
        sigma[joint] = max(float(size) / np.sqrt(left), floor)
    return sigma


@dataclass(frozen=True, eq=False)
class _Solution:
    """Values, the inverse of the equations' derivative, the rows' mean leverage by joint, and what they determine."""

    value: Array
    inverse: Array
    leverage: Array
    determined: Mask


class _Equations:
    """instruments^T W (target - columns @ value) + precision (mean - value) = 0."""

    def __init__(
        self, problem: ExcitationProblem, columns: Array, instruments: Array, target: Array, prior: Prior | None
    ) -> None:
        self.columns, self.instruments, self.target = columns, instruments, target
        rows = [np.flatnonzero(problem.joint == joint) for joint in range(len(problem.arm.names))]
        self._joints = [(own, columns[own]) for own in rows]
        self.precision: Array | None = None
        self._known = np.zeros(columns.shape[1])
        if prior is not None:
            known = prior.padded(columns.shape[1])
            self.precision = known.precision
            self._known = known.precision @ known.value

    def solved(self, weights: Array) -> _Solution:
        """Solve for weights of the rows, shape (r,); directions that the rows do not determine stay 0."""
        weighted = self.instruments * weights[:, None]
        # Of each joint by itself: its part tells its rows' leverages without a product of all rows with the inverse.
        parts = [weighted[own].T @ columns for own, columns in self._joints]
        gram = np.sum(parts, axis=0)
        right = weighted.T @ self.target + self._known
        if self.precision is not None:
            gram = gram + self.precision
        scale = np.sqrt(np.abs(np.diag(gram)))
        scale[scale == 0.0] = 1.0
        left, values, directions = np.linalg.svd(gram / np.outer(scale, scale))
        known = values > _MIN_SINGULAR_VALUE**2 * values[0]
        inverse = (directions[known].T / values[known]) @ left[:, known].T / np.outer(scale, scale)
        determined = (directions[~known] ** 2).sum(axis=0) < _MAX_NULL_SHARE
        counted = zip(parts, self._joints, strict=True)
        leverage = np.array([np.sum(inverse * part.T) / max(len(own), 1) for part, (own, _) in counted])
        return _Solution(inverse @ right, inverse, leverage, determined)


_MIN_BANDWIDTH = 2.0  # bandwidth of the kernel in instants, at least
_MAX_BANDWIDTH_SHARE = 0.25  # share of a run that it takes, at most
_TIME_BLOCKS = 20  # of time, about, of all runs together
_MIN_RUN_BLOCKS = 4  # of a run
_MAX_AUTOCORRELATION = 0.97  # first-order autocorrelation: above, a series has no finite bandwidth


def time_blocks(problem: ExcitationProblem) -> Index:
    """Return the number of each row's block of time, shape (r,): some twenty; repetitions of a motion share theirs."""
    lengths = _lengths(problem)
    counts = [max(_MIN_RUN_BLOCKS, round(_TIME_BLOCKS * length / sum(lengths))) for length in lengths]
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
        return _MIN_BANDWIDTH
    rho = np.clip(lagged[known] / power[known], -_MAX_AUTOCORRELATION, _MAX_AUTOCORRELATION)
    curvature = float(np.sum(4.0 * rho**2 / (1.0 - rho) ** 8) / np.sum(1.0 / (1.0 - rho) ** 4))
    width = 1.3221 * float((curvature * sum(len(values) for values in series)) ** 0.2)
    longest = max(len(values) for values in series)
    return max(_MIN_BANDWIDTH, min(width, _MAX_BANDWIDTH_SHARE * longest))


def quadratic_spectral(lag: Array) -> Array:
    """Return the quadratic spectral kernel at lags over the bandwidth; 1 at 0."""
    angle = 1.2 * math.pi * np.where(lag == 0.0, 1.0, lag)
    value = 3.0 / angle**2 * (np.sin(angle) / angle - np.cos(angle))
    return np.asarray(np.where(lag == 0.0, 1.0, value))
