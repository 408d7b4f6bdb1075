"""Least squares: a robust linear fit with deviations that hold under misfit, and a separable non-linear fit.

Every linear fit of excitation runs is one call of `solve`: the base fit, free exponents, parts that may exist, load
dependence.

Residuals of an excitation run are not white noise: effects outside the model (ripple, load, temperature) return with
the motion. So a fit is written as the sum of the contributions of all instants, their influences: inverse curvature
times score, all joints of an instant together. Its variance follows from these contributions and their correlation in
time alone, for residuals of any kind. Repetitions of a motion count as one (`problem.phases`): their contributions are
added before they are squared.

The residuals of a fit are smaller than the errors that they represent, most of all at the low frequencies of its
columns. Each block of time is therefore evaluated with the fit to all other blocks (as in the jackknife of Bell and
McCaffrey 2002, there for clusters); without that, 95 % intervals of random arms contain 91 to 93 % of the true values.

When shapes of friction are fitted, the linear parameters are eliminated, and SciPy optimises the others. Variable
projection (Golub and Pereyra 1973) with Kaufman's derivatives (1975). All joints and elements are fitted together, so
that friction parameters and the inertias that they are correlated with are found jointly. The search works on inner
products of columns: an element has rows on its own joints only, and a change of one element does not change the inner
products of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import least_squares, nnls
from scipy.signal import fftconvolve

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.excitation.law import (
    FITTED,
    LINEAR,
    SHAPED,
    ElementRows,
    ElementShape,
    Part,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Prior

_MAX_ROUNDS = 30
_CONVERGED = 1e-2  # change of a value in its deviations; the remaining change is some three times as much
_HUBER = 1.345  # deviations beyond which a residual weighs less: 95 % efficient for normal noise
_MIN_SINGULAR_VALUE = 1e-6  # singular value of scaled columns over the largest, below which a direction is undetermined
_MAX_NULL_SHARE = 1e-6  # share of undetermined directions in a parameter (squared) above which it is undetermined


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Parameters that are linear in the torque.

    Attributes:
        value: shape (q,); for undetermined directions, the shortest solution.
        covariance: of the values, shape (q, q): autocorrelation-consistent, residuals of each block of time from the
            fit to the others; infinite on the diagonal of undetermined parameters.
        residual: torque less the fit's prediction, Nm, shape (r,).
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
    problem: ExcitationProblem, columns: Array, torque: Array | None = None, *, prior: Prior | None = None
) -> LinearFit:
    """Fit a torque by columns, each joint weighted by its own residuals; outlying rows weigh less (Huber).

    The equation solved is columns^T W (torque - columns @ value) + precision (mean - value) = 0.

    Args:
        problem: r rows of n joints.
        columns: shape (r, q).
        torque: torque to explain, Nm, shape (r,); by default that of the problem.
        prior: of the first of the q parameters.
    """
    target = problem.torque if torque is None else torque
    joints = [np.flatnonzero(problem.joint == joint) for joint in range(len(problem.arm.names))]
    own_columns = [columns[rows] for rows in joints]
    precision = np.zeros((columns.shape[1],) * 2)
    known = np.zeros(columns.shape[1])
    if prior is not None:
        count = len(prior.value)
        precision[:count, :count] = prior.precision
        known[:count] = prior.precision @ prior.value

    def solved(weights: Array) -> tuple[Array, Array, Mask, Array]:
        """Return values, the inverse of the equations' derivative, determined parameters, and joints' leverages.

        Directions that the rows do not determine stay 0.
        """
        weighted = columns * weights[:, None]
        # Joint by joint: this gives the leverages of its rows without a product of all rows with the inverse.
        parts = [weighted[rows].T @ own for rows, own in zip(joints, own_columns, strict=True)]
        gram = np.sum(parts, axis=0) + precision
        scale = np.sqrt(np.abs(np.diag(gram)))
        scale[scale == 0.0] = 1.0
        left_vectors, values, directions = np.linalg.svd(gram / np.outer(scale, scale))
        there = values > _MIN_SINGULAR_VALUE**2 * values[0]
        inverse = (directions[there].T / values[there]) @ left_vectors[:, there].T / np.outer(scale, scale)
        determined = (directions[~there] ** 2).sum(axis=0) < _MAX_NULL_SHARE
        leverage = [np.sum(inverse * part.T) / max(len(rows), 1) for part, rows in zip(parts, joints, strict=True)]
        return inverse @ (weighted.T @ target + known), inverse, determined, np.array(leverage)

    sigma = np.full(len(joints), max(float(np.std(target)), 1e-12))
    floor = max(1e-9 * float(np.abs(problem.torque).max()), 1e-12)  # keeps the weights finite for data without noise
    weights = np.ones(len(target))
    value, inverse, determined, leverage = solved(weights / sigma[problem.joint] ** 2)
    for _ in range(_MAX_ROUNDS):
        before = value
        residual = target - columns @ value
        for joint, rows in enumerate(joints):
            if len(rows):
                size = 1.4826 * np.median(np.abs(residual[rows]))
                sigma[joint] = max(float(size) / np.sqrt(max(1.0 - float(leverage[joint]), 0.05)), floor)
        weights = np.minimum(1.0, _HUBER * sigma[problem.joint] / np.maximum(np.abs(residual), 1e-300))
        value, inverse, determined, leverage = solved(weights / sigma[problem.joint] ** 2)
        deviation = np.sqrt(np.maximum(np.abs(np.diag(inverse)), 1e-300))
        if np.max(np.abs(value - before) / deviation, initial=0.0) < _CONVERGED:
            break
    residual = target - columns @ value
    per_row = 1.0 / sigma[problem.joint] ** 2
    weighted = columns * (per_row * weights)[:, None]
    outside = outside_residuals(columns, weighted, residual, time_blocks(problem))
    # Huber's criterion is quadratic where the weight is 1 and linear beyond.
    curvature = solved(per_row * (weights == 1.0))[1]
    influence = _influence_by_time(problem, (weighted * outside[:, None]) @ curvature.T)
    covariance = hac(influence) + curvature @ precision @ curvature.T
    covariance[~determined, ~determined] = np.inf
    return LinearFit(value, covariance, residual, sigma, weights, determined, influence)


_MIN_BANDWIDTH = 2.0  # least bandwidth of the kernel, in instants
_MAX_BANDWIDTH_SHARE = 0.25  # largest bandwidth, as a share of a run
_TIME_BLOCKS = 20  # approximate number of blocks of all runs together
_MIN_RUN_BLOCKS = 4  # of a run
_MAX_AUTOCORRELATION = 0.97  # first-order autocorrelation, above which a series has no finite bandwidth


def time_blocks(problem: ExcitationProblem) -> Index:
    """Return the number of each row's block of time, shape (r,): about twenty blocks; repetitions share theirs."""
    lengths = problem.motion_lengths
    counts = np.maximum(_MIN_RUN_BLOCKS, np.round(_TIME_BLOCKS * lengths / lengths.sum()).astype(np.intp))
    first = np.cumsum(counts) - counts
    motion = problem.motion
    return np.asarray(first[motion] + problem.phase * counts[motion] // lengths[motion])


def outside_residuals(columns: Array, weighted: Array, residual: Array, block: Index) -> Array:
    """Return residuals of each block of rows from the fit to all other blocks, shape (r,).

    The equations of the fit are weighted^T (target - columns @ value) = 0.

    Args:
        columns: shape (r, q).
        weighted: the columns times the weights of the rows, shape (r, q).
        residual: of the fit to all rows, shape (r,).
        block: number of each row's block, shape (r,).
    """
    whole = weighted.T @ columns
    outside = residual.copy()
    for number in np.unique(block).tolist():
        rows = block == number
        without = whole - weighted[rows].T @ columns[rows]
        outside[rows] += columns[rows] @ lstsq(without, weighted[rows].T @ residual[rows], cond=1e-12)[0]
    return outside


def _influence_by_time(problem: ExcitationProblem, influence: Array) -> tuple[Array, ...]:
    """Return the rows' influences, shape (r, q), by motion and instant, repetitions added, shape (k, q) each."""
    ends = np.cumsum(problem.motion_lengths)
    whole = np.zeros((ends[-1], influence.shape[1]))
    np.add.at(whole, (ends - problem.motion_lengths)[problem.motion] + problem.phase, influence)
    return tuple(np.split(whole, ends[:-1]))


def hac(series: Sequence[Array]) -> Array:
    """Return the heteroscedasticity- and autocorrelation-consistent covariance of sums of influences, shape (q, q).

    Quadratic spectral kernel (Andrews 1991, equation 2.7); instants of different motions are independent. The bandwidth
    follows his equations 6.2 and 6.4, with a first-order autoregression of each parameter's series and equal weights of
    the parameters.

    Args:
        series: of each motion, shape (k, q).
    """
    lagged = np.sum([np.sum(values[1:] * values[:-1], axis=0) for values in series], axis=0)
    power = np.sum([np.sum(values**2, axis=0) for values in series], axis=0)
    known = power > 0.0
    width = _MIN_BANDWIDTH
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


Key = tuple[int, str]
"""Number of an element, and the name of one of its parameters in FITTED."""

_RANGES = {"alpha": (0.2, 2.0), "rise": (0.0, 1.5), "delta": (0.5, 2.5)}
_STRIBECK_OVER_SPEED = (1.0, 0.1)  # Stribeck velocity: over the least and over the greatest speed with data
_LONGEST_PRESLIDING = 0.3  # rad, 1 / stiffness
_CACHED_SHAPES = 6  # number of an element's shapes whose inner products are cached


@dataclass(frozen=True, eq=False)
class SeparableFit:
    """A model fitted to weighted rows.

    Attributes:
        shapes: of the elements.
        linear: tau_c, c2 and c1 of each element, none negative, shape (n_el, 3).
        at_bound: names of the free parameters of each element that lie on a bound.
    """

    shapes: tuple[ElementShape, ...]
    linear: Array
    at_bound: tuple[frozenset[str], ...]

    def inner(self) -> tuple[Key, ...]:
        """Return element and name of every fitted parameter of the friction that is not at a bound."""
        found = []
        for e, (shape, values) in enumerate(zip(self.shapes, self.linear, strict=True)):
            found += [(e, name) for name, value in zip(LINEAR, values, strict=True) if value > 0.0]
            # Parameters that shape a zero torque have no meaning.
            found += [(e, name) for name in shape.free if name not in self.at_bound[e] and values[SHAPED[name]] > 0.0]
        return tuple(found)


class _Columns(NamedTuple):
    """Weighted columns of an element and their derivatives, shape (s, k); their inner products with basis and rest."""

    values: Array
    projected: Array
    product: Array


@dataclass(frozen=True, eq=False)
class WeightedProblem:
    """The rows of a problem with their weights; the linear parameters beside friction are eliminated once.

    Attributes:
        problem: the rows.
        elements: the rows of each friction element.
        weight: square roots of the weights: residuals times these have unit noise, shape (r,).
        basis: orthonormal columns that span the weighted regressor, shape (r, p).
        rest: weighted torque less its projection on the basis, shape (r,).
        shared: for pairs of elements that act on a joint together, the places of their common rows in each.
    """

    problem: ExcitationProblem
    elements: tuple[ElementRows, ...]
    weight: Array
    basis: Array
    rest: Array
    shared: dict[tuple[int, int], tuple[Index, Index]]
    _kept: dict[int, dict[ElementShape, _Columns]] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: ExcitationProblem, elements: tuple[ElementRows, ...], weight: Array) -> WeightedProblem:
        """Return the weighted rows."""
        basis = np.linalg.qr(problem.regressor * weight[:, None])[0]
        target = problem.torque * weight
        shared = {}
        for e, one in enumerate(elements):
            for f, other in enumerate(elements[:e]):
                _, first, second = np.intersect1d(one.rows, other.rows, assume_unique=True, return_indices=True)
                if len(first):
                    shared[e, f] = (first, second)
        return cls(problem, elements, weight, basis, target - basis @ (basis.T @ target), shared)

    def bounds(self, element: int, name: str) -> tuple[float, float]:
        """Return the range of a free parameter of an element, as the fit writes it."""
        if name in _RANGES:
            return _RANGES[name]
        if name == "stiffness":
            shortest = min(self.elements[element].shortest_presliding, 0.1 * _LONGEST_PRESLIDING)
            return -float(np.log(_LONGEST_PRESLIDING)), -float(np.log(shortest))
        low, high = self.elements[element].speed_range
        least = _STRIBECK_OVER_SPEED[0] * max(low, 1e-4)
        return float(np.log(least)), float(np.log(max(_STRIBECK_OVER_SPEED[1] * high, 2.0 * least)))

    def gram(self, shapes: Sequence[ElementShape]) -> tuple[Array, Array, Array]:
        """Return inner products of all elements' columns, with the regressor projected out.

        The columns of an element are those of LINEAR, then their derivatives by each free parameter: k in all.

        Returns:
            Products of columns with columns, shape (k, k), and with the torque, shape (k,), and the first column of
            each element.
        """
        blocks = [self._columns(e, shape) for e, shape in enumerate(shapes)]
        edges = np.cumsum([0, *(block.values.shape[1] for block in blocks)])
        places = [slice(*pair) for pair in pairwise(edges)]
        projected = np.hstack([block.projected for block in blocks])
        gram = -projected.T @ projected
        for block, place in zip(blocks, places, strict=True):
            gram[place, place] += block.values.T @ block.values
        for (e, f), (first, second) in self.shared.items():
            product = blocks[e].values[first].T @ blocks[f].values[second]
            gram[places[e], places[f]] += product
            gram[places[f], places[e]] += product.T
        return gram, np.concatenate([block.product for block in blocks]), edges

    def column(self, shapes: Sequence[ElementShape], linear: Array, key: Key) -> Array:
        """Return the weighted derivative of the torque by a parameter, shape (r,).

        Args:
            shapes: of the elements.
            linear: tau_c, c2, c1 of each, shape (n_el, 3).
            key: the parameter, which need not be free.
        """
        element, name = key
        result = np.zeros(len(self.weight))
        rows = self.elements[element].rows
        if name in LINEAR:
            result[rows] = self._columns(element, shapes[element]).values[:, LINEAR.index(name)]
        else:
            shape = shapes[element].with_free(name)
            place = len(LINEAR) * (1 + shape.free.index(name))
            result[rows] = self._columns(element, shape).values[:, place : place + len(LINEAR)] @ linear[element]
        return result

    def tangent(self, fit: SeparableFit, inner: Sequence[Key]) -> Array:
        """Return the unweighted columns of the whole model, linear around a fit, shape (r, q).

        Args:
            fit: the point of linearisation.
            inner: the friction's parameters, whose columns follow the regressor. Those of non-linear parameters belong
                to changes of these.
        """
        return np.hstack([self.problem.regressor, self._friction(fit, inner) / self.weight[:, None]])

    def _friction(self, fit: SeparableFit, inner: Sequence[Key]) -> Array:
        columns = [self.column(fit.shapes, fit.linear, key) for key in inner]
        return np.stack(columns, axis=1) if columns else np.empty((len(self.weight), 0))

    def linearised(self, fit: SeparableFit) -> tuple[Array, Array]:
        """Return weighted residuals of a fit, shape (r,), and the model's tangent there, shape (r, k).

        The tangent consists of the weighted derivatives of the torques by every fitted parameter that is not at a
        bound, as columns of length 1: the basis of the regressor, then friction.
        """
        inner = fit.inner()
        friction = self._friction(fit, inner)
        linear = np.array([fit.linear[e, LINEAR.index(name)] if name in LINEAR else 0.0 for e, name in inner])
        without = self.problem.torque * self.weight - friction @ linear
        size = np.linalg.norm(friction, axis=0)
        tangent = np.hstack([self.basis, friction / np.where(size > 0.0, size, 1.0)])
        return without - self.basis @ (self.basis.T @ without), tangent

    def _columns(self, element: int, shape: ElementShape) -> _Columns:
        kept = self._kept.setdefault(element, {})
        if shape not in kept:
            while len(kept) >= _CACHED_SHAPES:
                kept.pop(next(iter(kept)))
            rows = self.elements[element].rows
            values = self.elements[element].columns(shape) * self.weight[rows, None]
            kept[shape] = _Columns(values, self.basis[rows].T @ values, values.T @ self.rest[rows])
        return kept[shape]


_MAX_EVALUATIONS = 40
_TOLERANCE = 1e-8  # of cost and parameters
_AT_BOUND = 1e-3  # of the width of the range
_ROUNDING = 1e-13  # of a column's square over the greatest
_MIN_EIGENVALUE = 1e-10  # of a Gram matrix, relative: smaller ones are rounding


def fit_shapes(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], only: Sequence[int] | None = None
) -> SeparableFit:
    """Fit linear and free non-linear parameters.

    Args:
        weighted: the rows.
        shapes: to start from.
        only: elements whose non-linear parameters are fitted; by default all.
    """
    moving = range(len(shapes)) if only is None else only
    edges = np.cumsum([0, *(len(shapes[e].free) for e in moving)])

    def shapes_at(x: Array) -> list[ElementShape]:
        found = list(shapes)
        for e, (first, last) in zip(moving, pairwise(edges), strict=True):
            found[e] = found[e].with_values(x[first:last])
        return found

    @lru_cache(1)  # residuals and derivatives are requested at the same values, one after the other
    def at(*x: float) -> Array:
        return _projected(weighted, shapes_at(np.array(x)), moving)[2]

    best = list(shapes)
    if edges[-1]:
        start = np.concatenate([shapes[e].values for e in moving])
        low, high = np.array([weighted.bounds(e, name) for e in moving for name in shapes[e].free]).T
        found = least_squares(
            lambda x: at(*x)[:, -1],  # type: ignore[misc]
            np.clip(start, low, high),
            lambda x: at(*x)[:, :-1],  # type: ignore[misc]
            (low, high), ftol=_TOLERANCE, xtol=_TOLERANCE, max_nfev=_MAX_EVALUATIONS,
        )  # fmt: skip
        best = shapes_at(np.asarray(found.x))
    at_bound = []
    for e, shape in enumerate(best):
        least, most = np.array([weighted.bounds(e, name) for name in shape.free]).reshape(-1, 2).T
        near = np.minimum(shape.values - least, most - shape.values) < _AT_BOUND * (most - least)
        at_bound.append(frozenset(name for name, one in zip(shape.free, near.tolist(), strict=True) if one))
    return SeparableFit(tuple(best), _projected(weighted, best, moving)[0], tuple(at_bound))


def best_start(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], element: int, candidates: Sequence[ElementShape]
) -> ElementShape:
    """Return the candidate shape of an element that fits best, with the other elements unchanged."""

    def cost(candidate: ElementShape) -> float:
        there = [*shapes[:element], candidate, *shapes[element + 1 :]]
        # Costs need no derivatives: for a bristle each of them would take one more deflection.
        return _projected(weighted, [replace(shape, fixed=frozenset(FITTED)) for shape in there], ())[1]

    return min(candidates, key=cost)


def _projected(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], only: Sequence[int]
) -> tuple[Array, float, Array]:
    """Return the best linear parameters, (n_el, 3), the remaining sum of squares, and Kaufman's derivatives.

    The derivatives, by the t free parameters of the elements `only`, with the residuals behind them, have shape
    (t + 1, t + 1): up to a rotation, which changes no sum of squares.
    """
    gram, product, edges = weighted.gram(shapes)
    keys = [(e, k) for e, shape in enumerate(shapes) for k in range(3 if Part.DAMPING in shape.parts else 2)]
    columns = np.array([edges[e] + place for e, place in keys])
    values = nonnegative(gram[np.ix_(columns, columns)], product[columns])
    linear = np.zeros((len(shapes), len(LINEAR)))
    linear[tuple(np.transpose(keys))] = values
    free = [(e, edges[e] + len(LINEAR) * (1 + k)) for e in only for k in range(len(shapes[e].free))]
    slopes = np.zeros((len(free), len(gram))).T
    for column, (e, first) in enumerate(free):
        slopes[first : first + len(LINEAR), column] = linear[e]
    # A root of the inner products of derivatives and residual, with the active linear columns projected out.
    active = columns[values > 0.0]
    values = values[values > 0.0]
    mixed = gram[active] @ slopes
    inverse = np.linalg.pinv(gram[np.ix_(active, active)], rcond=_MIN_EIGENVALUE, hermitian=True)
    cost = max(float(weighted.rest @ weighted.rest) - float(product[active] @ values), 0.0)
    table = np.empty((len(free) + 1,) * 2)
    table[:-1, :-1] = slopes.T @ gram @ slopes - mixed.T @ inverse @ mixed
    # The derivatives of the residual are minus those of the torque; the residual is orthogonal to active columns.
    table[-1, :-1] = table[:-1, -1] = mixed.T @ values - slopes.T @ product
    table[-1, -1] = cost
    scale = np.sqrt(np.maximum(np.diag(table), 1e-300))
    size, vectors = np.linalg.eigh(table / np.outer(scale, scale))
    return linear, cost, np.asarray((vectors * np.sqrt(np.maximum(size, 0.0))).T * scale)


def nonnegative(gram: Array, product: Array) -> Array:
    """Return the x >= 0 that minimises x' gram x / 2 - product' x, shape (k,), of a Gram matrix of shape (k, k)."""
    # Of a column that the regressor explains, such as that of a joint that turns one way, only rounding remains.
    square = np.diag(gram)
    scale = np.sqrt(np.where(square > _ROUNDING * square.max(initial=0.0), square, 1.0))
    size, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    known = size > _MIN_EIGENVALUE * max(size[-1], 0.0)
    if not known.any():
        return np.zeros(len(product))
    root = np.sqrt(size[known])
    target = (vectors[:, known] / root).T @ (product / scale)
    return np.asarray(nnls((vectors[:, known] * root).T, target)[0] / scale)
