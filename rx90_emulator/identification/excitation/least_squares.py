"""Weighted, robust least squares with deviations that hold under misfit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.excitation.covariance import hac, influence_by_time
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_ROUNDS = 30
_CONVERGED = 1e-6  # change of a value in its deviations
_HUBER = 1.345  # deviations beyond which a residual weighs less: 95 % efficient for normal noise
_UNDETERMINED = 1e-6  # share of the largest singular value of scaled columns, below which a direction is unknown


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Parameters that are linear in the torque.

    Attributes:
        value: shape (q,); the shortest solution where the rows do not determine it.
        covariance: of the values, HAC, shape (q, q); infinite on the diagonal of what is not determined.
        residual: torque less what the fit predicts, Nm, shape (r,).
        sigma: standard deviation of each joint's residuals by which its rows are weighted, Nm, shape (n,).
        weights: robust weights between 0 and 1, shape (r,).
        determined: whether the rows determine each parameter, shape (q,).
        condition: ratio of the largest and smallest singular values of the weighted rows with columns of length 1.
    """

    value: Array
    covariance: Array
    residual: Array
    sigma: Array
    weights: Array
    determined: Mask
    condition: float

    @property
    def deviation(self) -> Array:
        """Return standard deviations, shape (q,)."""
        return np.sqrt(np.diag(self.covariance))


def solve(problem: ExcitationProblem, columns: Array, torque: Array | None = None, *, robust: bool = True) -> LinearFit:
    """Fit a torque by columns, each joint weighted by its own residuals.

    Args:
        problem: r rows of n joints.
        columns: shape (r, q).
        torque: to explain, Nm, shape (r,); by default that of the problem.
        robust: whether rows far off weigh less (Huber); else all rows of a joint weigh the same.
    """
    target = problem.torque if torque is None else torque
    joints = len(problem.arm.names)
    sigma = np.full(joints, max(float(np.std(target)), 1e-12))
    weights = np.ones(len(target))
    solution = _Solution.of(columns, target, weights / sigma[problem.joint] ** 2)
    for _ in range(_ROUNDS):
        before = solution.value
        residual = target - columns @ before
        free = 1.0 - solution.leverage(columns)
        sigma = _sigma(problem, residual, free, sigma, robust=robust)
        scaled = np.abs(residual) / sigma[problem.joint]
        weights = np.minimum(1.0, _HUBER / np.maximum(scaled, 1e-12)) if robust else weights
        solution = _Solution.of(columns, target, weights / sigma[problem.joint] ** 2)
        change = np.abs(solution.value - before) / np.sqrt(np.maximum(np.diag(solution.inverse), 1e-300))
        if np.max(change, initial=0.0) < _CONVERGED:
            break
    residual = target - columns @ solution.value
    per_row = 1.0 / sigma[problem.joint] ** 2
    # Huber's criterion is quadratic where the weight is 1 and straight beyond.
    curvature = (columns * (per_row * (weights == 1.0))[:, None]).T @ columns
    series = influence_by_time(problem, columns * (per_row * weights * residual)[:, None], curvature)
    covariance = hac(series)
    covariance[~solution.determined, ~solution.determined] = np.inf
    return LinearFit(solution.value, covariance, residual, sigma, weights, solution.determined, solution.condition)


def _sigma(problem: ExcitationProblem, residual: Array, free: Array, before: Array, *, robust: bool) -> Array:
    """Return the deviation of each joint's residuals; `free` is each row's share that the fit leaves, shape (r,)."""
    sigma = before.copy()
    for joint in range(len(before)):
        rows = problem.joint == joint
        if not rows.any():
            continue
        left = max(float(np.mean(free[rows])), 0.05)
        size = 1.4826 * np.median(np.abs(residual[rows])) if robust else np.sqrt(np.mean(residual[rows] ** 2))
        # A floor keeps the weights finite for data without noise.
        sigma[joint] = max(float(size) / np.sqrt(left), 1e-9 * float(np.abs(problem.torque).max()), 1e-12)
    return sigma


@dataclass(frozen=True, eq=False)
class _Solution:
    """Of weighted normal equations with columns scaled to length 1."""

    value: Array
    inverse: Array
    weights: Array
    determined: Mask
    condition: float

    @classmethod
    def of(cls, columns: Array, target: Array, weights: Array) -> _Solution:
        weighted = columns * weights[:, None]
        gram = columns.T @ weighted
        scale = np.sqrt(np.diag(gram))
        scale[scale == 0.0] = 1.0
        values, directions = np.linalg.eigh(gram / np.outer(scale, scale))
        known = values > _UNDETERMINED**2 * values[-1]
        root = directions[:, known] / np.sqrt(values[known])
        inverse = root @ root.T / np.outer(scale, scale)
        determined = (directions[:, ~known] ** 2).sum(axis=1) < 1e-6
        condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
        return cls(inverse @ (weighted.T @ target), inverse, weights, determined, condition)

    def leverage(self, columns: Array) -> Array:
        """Return the diagonal of the hat matrix, shape (r,)."""
        return np.asarray(np.sum((columns @ self.inverse) * columns, axis=1) * self.weights)
