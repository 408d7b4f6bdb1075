"""Weighted, robust least squares, with or without instruments, and deviations that hold under misfit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.excitation.covariance import (
    hac,
    influence_by_time,
    outside_residuals,
    time_blocks,
)
from rx90_emulator.identification.excitation.prior import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_ROUNDS = 30
_CONVERGED = 1e-2  # change of a value in its deviations; what is left to change is some three times as much
_HUBER = 1.345  # deviations beyond which a residual weighs less: 95 % efficient for normal noise
_UNDETERMINED = 1e-6  # singular value of scaled columns over the largest, below which a direction is unknown
_SHARE = 1e-6  # of such a direction's square in a parameter, from which on that is not determined


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
        condition: ratio of the largest and smallest singular values of the weighted columns, each of length 1.
        influence: each motion's influences on the values, shape (k, q): see `covariance`.
    """

    value: Array
    covariance: Array
    residual: Array
    sigma: Array
    weights: Array
    determined: Mask
    condition: float
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
    for _ in range(_ROUNDS):
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
    return LinearFit(
        solution.value, covariance, residual, sigma, weights, solution.determined, solution.condition, tuple(influence)
    )


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
    condition: float


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
        known = values > _UNDETERMINED**2 * values[0]
        inverse = (directions[known].T / values[known]) @ left[:, known].T / np.outer(scale, scale)
        determined = (directions[~known] ** 2).sum(axis=0) < _SHARE
        counted = zip(parts, self._joints, strict=True)
        leverage = np.array([np.sum(inverse * part.T) / max(len(own), 1) for part, (own, _) in counted])
        condition = float(np.sqrt(values[0] / max(values[-1], 1e-300)))
        return _Solution(inverse @ right, inverse, leverage, determined, condition)
