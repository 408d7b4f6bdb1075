"""Weighted non-linear least squares: parameters, and the weights of the rows, from the residuals themselves.

A problem is r equations

    target = model(x) + linear @ p + noise

with the parameters x of interest and others, p, that no other parameter shapes: a rigid body, offsets, errors of a
description. For given x the best p is that of a linear fit, so p is eliminated exactly, once, by an orthogonal basis Q
of the weighted columns (Golub and Pereyra 1973, variable projection): what SciPy minimises is the length of

    (I - Q Q^T) W (target - model(x)).

Rows come in groups of equal noise, such as those of one joint in one run. W is one over a group's noise, estimated from
its residuals by their median absolute deviation, and less where a row lies far out (Huber 1981, Robust Statistics).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares, lsq_linear

from rx90_common.base.arrays import Array, Index, Mask

REWEIGHTINGS = 3
"""Of iteratively reweighted least squares: a fourth changes values by less than a tenth of their deviations."""
HUBER = 2.5
"""Residual, in deviations of the noise, from which a row weighs less. Of few rows with many parameters, whose noise is
estimated low, a smaller one takes a fifth for outliers."""
MAD_TO_DEVIATION = 1.4826
"""Standard deviation of normal noise over the median of its absolute value."""
LEAST_NOISE = 1e-9
"""Noise of a group over the largest target, at least: keeps the weights finite for data without noise."""
RANK = 1e-9
"""Length of a column's new part over that of the column, below which it is a combination of the others."""
SQUARED_RANK = 1e-7
"""The same of derivatives that come from their squares, which are exact to 1e-8."""
NEAR_BOUND = 1e-3
"""Share of a range, or of the residuals' length, within which a parameter is at its bound."""
TOLERANCE = 1e-8
MOST_EVALUATIONS = 60
"""Of the model in one minimisation. Well-posed problems need about ten."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Equations of r rows, q parameters x and p linear parameters.

    Attributes:
        target: shape (r,).
        linear: columns of the linear parameters, shape (r, p).
        model: returns, for parameters x, what they contribute to the rows, (r,), and its derivatives, (r, q).
        start: of the parameters, shape (q,).
        lower: bounds, shape (q,).
        upper: shape (q,).
        group: number of each row's group of equal noise, from 0, shape (r,).
        block: number of each row's block; errors of different blocks are independent, shape (r,).
        prior: rows `prior @ p = 0` with noise 1, of what is known of the linear parameters, shape (s, p).
        spread: standard deviation of what is known of each parameter about `start`; infinite if nothing is, (q,).
    """

    target: Array
    linear: Array
    model: Callable[[Array], tuple[Array, Array]]
    start: Array
    lower: Array
    upper: Array
    group: Index
    block: Index
    prior: Array
    spread: Array

    @cached_property
    def known(self) -> Index:
        """Return the numbers of the parameters x that have a prior."""
        return np.flatnonzero(np.isfinite(self.spread))


class Fit(NamedTuple):
    """A problem's solution.

    Attributes:
        problem: the equations.
        x: parameters, shape (q,).
        linear: the linear parameters, the shortest of those that fit equally well, shape (p,).
        slopes: derivatives of the model at x, shape (r, q).
        residual: target less all that is fitted, shape (r,).
        noise: standard deviation of each group's noise, shape (groups,).
        weight: of each row's square, 1 / noise^2 or less, shape (r,).
        at_bound: parameters x that lie at a bound, shape (q,).
        outlying: rows that weigh less than their group does: their loss grows linearly, shape (r,).
        cost: sum of the weighted squares, priors included.
    """

    problem: Problem
    x: Array
    linear: Array
    slopes: Array
    residual: Array
    noise: Array
    weight: Array
    at_bound: Mask
    outlying: Mask
    cost: float

    @property
    def columns(self) -> Array:
        """Return weighted derivatives by x, 0 at a bound, then by the linear parameters, shape (r, q + p)."""
        columns = np.hstack([np.where(self.at_bound, 0.0, self.slopes), self.problem.linear])
        return np.asarray(np.sqrt(self.weight)[:, None] * columns)

    def scaled(self) -> tuple[Array, Array, Array]:
        """Return `columns` and what else is known of their parameters, in parts of their sizes.

        Returns:
            The columns, the inverse covariance of that knowledge, shape (q + p, q + p), and the sizes, shape (q + p,);
            1 where nothing is known.
        """
        columns = self.columns
        count = len(self.x)
        prior = np.zeros((columns.shape[1],) * 2)
        matrix = self.problem.prior
        prior[count:, count:] = matrix.T @ matrix
        known = self.problem.known
        prior[known, known] = 1.0 / self.problem.spread[known] ** 2
        size = np.sqrt(np.sum(columns**2, axis=0) + np.diag(prior))
        size[size == 0.0] = 1.0
        return columns / size, prior / np.outer(size, size), size


def fit(problem: Problem, weight: Array | None = None) -> Fit:
    """Return the parameters that fit best, from the problem's start.

    Args:
        problem: the equations.
        weight: of each row's square, shape (r,); by default estimated from the residuals. Costs of models can be
            compared only with the same weights.
    """
    if weight is not None:
        return _fitted(problem, problem.start, weight)
    least = max(
        LEAST_NOISE * float(np.abs(problem.target).max(initial=0.0)),
        np.finfo(np.float64).tiny ** 0.25,
    )
    spread = of_groups(problem, problem.target, np.std)
    x = problem.start
    linear = Projected(problem, 1.0 / np.maximum(spread, least)[problem.group] ** 2).linear(x)
    residual = problem.target - problem.model(x)[0] - problem.linear @ linear
    for _ in range(REWEIGHTINGS + 1):
        size = np.abs(residual)
        noise = np.maximum(_noise(problem, residual), least)
        over = HUBER * noise[problem.group] / np.maximum(size, np.finfo(np.float64).tiny)
        weight = np.minimum(1.0, over) / noise[problem.group] ** 2
        result = _fitted(problem, x, weight)
        x = result.x
        residual = result.residual
    return result._replace(noise=noise, outlying=over < 1.0)


def _noise(problem: Problem, residual: Array) -> Array:
    """Return the standard deviation of each group's noise, shape (groups,)."""
    return MAD_TO_DEVIATION * of_groups(problem, np.abs(residual), np.median)


def of_groups(problem: Problem, values: Array, measure: Callable[[Array], Any]) -> Array:
    """Return a measure of the values of each group, shape (groups,); 0 for one without rows."""
    groups = range(problem.group.max(initial=-1) + 1)
    parts = (values[problem.group == group] for group in groups)
    return np.array([measure(part) if len(part) else 0.0 for part in parts])


class Projected:
    """The equations with given weights, without the linear parameters.

    Args:
        problem: the equations.
        weight: of each row's square, shape (r,).
    """

    def __init__(self, problem: Problem, weight: Array) -> None:
        self._problem = problem
        self._root = np.sqrt(weight)
        self._columns = np.vstack([problem.linear * self._root[:, None], problem.prior])
        self._basis = independent_basis(self._columns)
        # residuals and derivatives are asked for at the same values
        self._kept = lru_cache(1)(self._at)

    def residual(self, x: Array) -> Array:
        """Return the residuals' components along the derivatives and their length across, shape (q + 1,).

        Squares and gradient are those of all weighted residuals, which are many more.
        """
        return self._kept(x.tobytes())[:, 0]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of `residual`, shape (q + 1, q)."""
        return self._kept(x.tobytes())[:, 1:]

    def linear(self, x: Array) -> Array:
        """Return the best linear parameters."""
        value, _ = self._weighted(x)
        size = _lengths(self._columns)
        return np.linalg.lstsq(self._columns / size, value, rcond=RANK)[0] / size

    def best_start(self, starts: Iterable[Array], moved: Mask) -> Array:
        """Return the start from which one linear step of some parameters leaves the least squares, step included.

        Args:
            starts: of all parameters, shape (q,) each; at least one.
            moved: the parameters of the step, which the model is linear in; the others keep their values, (q,).
        """
        lower = self._problem.lower
        upper = self._problem.upper
        best = self._problem.start
        least = np.inf
        for start in starts:
            x = np.clip(start, lower, upper)
            jacobian = self.jacobian(x)
            shown = moved & np.any(jacobian != 0.0, axis=0)
            jacobian = jacobian[:, shown]
            size = _lengths(jacobian)
            value = jacobian @ x[shown] - self.residual(x)
            with np.errstate(invalid="ignore"):  # SciPy's way to bounds at infinity
                step = lsq_linear(
                    jacobian / size, value, (lower[shown] * size, upper[shown] * size)
                )
            if step.cost < least:
                least = float(step.cost)
                best = x.copy()
                best[shown] = step.x / size
        return best

    def _at(self, values: bytes) -> Array:
        problem = self._problem
        x = np.frombuffer(values)
        value, slopes = self._weighted(x)
        both = np.column_stack([value, -slopes])
        both -= self._basis @ (self._basis.T @ both)
        known = problem.known
        if len(known):
            from_prior = np.eye(len(x))[known]
            rows = (
                np.column_stack([x[known] - problem.start[known], from_prior])
                / problem.spread[known, None]
            )
            both = np.vstack([both, rows])
        length = np.linalg.norm(both, axis=0)
        both /= np.where(length > 0.0, length, 1.0)
        squares, directions = np.linalg.eigh(both.T @ both)
        squares[squares < len(squares) * np.finfo(np.float64).eps * squares[-1]] = 0.0  # rounding
        return np.asarray(np.sqrt(squares)[:, None] * directions.T * length)

    def _weighted(self, x: Array) -> tuple[Array, Array]:
        torque, slopes = self._problem.model(x)
        both = np.column_stack([self._problem.target - torque, slopes]) * self._root[:, None]
        prior = np.zeros((len(self._problem.prior), both.shape[1]))
        value, slopes = np.split(np.vstack([both, prior]), [1], axis=1)
        return value[:, 0], slopes


def independent_basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns, shape (r, p), without those that combine others, shape (r, <= p)."""
    if not columns.size:
        return np.empty((len(columns), 0))
    basis, upper, _ = qr(columns / _lengths(columns), mode="economic", pivoting=True)
    return np.asarray(basis[:, np.abs(np.diag(upper)) > RANK])


def _lengths(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    return np.where(length > 0.0, length, 1.0)


def _fitted(problem: Problem, start: Array, weight: Array) -> Fit:
    projected = Projected(problem, weight)
    x = np.array(start, dtype=np.float64)
    if len(x):
        result = least_squares(
            projected.residual,
            np.clip(x, problem.lower, problem.upper),
            projected.jacobian,
            (problem.lower, problem.upper),
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            max_nfev=MOST_EVALUATIONS,
        )
        x = result.x
    linear = projected.linear(x)
    torque, slopes = problem.model(x)
    residual = problem.target - torque - problem.linear @ linear
    squares = projected.residual(x)
    jacobian = projected.jacobian(x)
    return Fit(
        problem=problem,
        x=x,
        linear=linear,
        slopes=slopes,
        residual=residual,
        noise=_noise(problem, residual),
        weight=weight,
        at_bound=_at_bound(problem, x, squares, jacobian),
        outlying=np.zeros(len(residual), dtype=np.bool_),
        cost=float(squares @ squares),
    )


def _at_bound(problem: Problem, x: Array, residual: Array, jacobian: Array) -> Mask:
    """Return which parameters a bound holds: they are there, or a Gauss-Newton step of those that are not passes it."""
    size = _lengths(jacobian)
    width = problem.upper - problem.lower
    # of a torque without an upper bound
    share = NEAR_BOUND * float(np.linalg.norm(residual)) / size
    margin = np.where(np.isfinite(width), NEAR_BOUND * width, share)
    near = (x - problem.lower <= margin) | (problem.upper - x <= margin)
    free = ~near
    step = np.zeros(len(x))
    step[free] = (
        np.linalg.lstsq(jacobian[:, free] / size[free], -residual, rcond=SQUARED_RANK)[0]
        / size[free]
    )
    return near | (x + step < problem.lower) | (x + step > problem.upper)
