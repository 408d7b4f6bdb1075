"""Separable non-linear least squares: the linear parameters are eliminated, SciPy optimises the others.

Variable projection (Golub and Pereyra 1973) with Kaufman's derivatives (1975). All joints and elements are fitted
together, so that a friction parameter answers for the inertias with which it is correlated. The search works on inner
products of columns: an element has rows on its own joints only, and a change of one element leaves those of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, nnls

from rx90_common.base.arrays import Array, Index
from rx90_emulator.identification.excitation.law import (
    FITTED,
    LINEAR,
    SHAPED,
    ElementRows,
    ElementShape,
    Part,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem

Key = tuple[int, str]
"""Number of an element, and the name of one of its parameters in FITTED."""

_RANGES = {"alpha": (0.2, 2.0), "rise": (0.0, 1.5), "delta": (0.5, 2.5)}
_STRIBECK_OVER_SPEED = (1.0, 0.1)  # Stribeck velocity: over the least and over the greatest speed with data
_LONGEST_PRESLIDING = 0.3  # rad, 1 / stiffness
_CACHED_SHAPES = 6  # shapes of an element whose inner products are kept


@dataclass(frozen=True, eq=False)
class SeparableFit:
    """A model fitted to weighted rows.

    Attributes:
        shapes: of the elements.
        linear: tau_c, c2 and c1 of each, none negative, shape (n_el, 3).
        at_bound: names of the free parameters of each element that lie on a bound.
    """

    shapes: tuple[ElementShape, ...]
    linear: Array
    at_bound: tuple[frozenset[str], ...]

    def inner(self) -> tuple[Key, ...]:
        """Return element and name of everything in the friction that is fitted and not at a bound."""
        found = []
        for e, (shape, values) in enumerate(zip(self.shapes, self.linear, strict=True)):
            found += [(e, name) for name, value in zip(LINEAR, values, strict=True) if value > 0.0]
            # Without a torque that they shape, such parameters have no meaning.
            found += [(e, name) for name in shape.free if name not in self.at_bound[e] and values[SHAPED[name]] > 0.0]
        return tuple(found)


class _Columns(NamedTuple):
    """Weighted columns of an element and their derivatives, shape (s, k); their inner products with basis and rest."""

    values: Array
    projected: Array
    product: Array


@dataclass(frozen=True, eq=False)
class WeightedProblem:
    """The rows of a problem with their weights; what is linear but friction is eliminated once.

    Attributes:
        problem: the rows.
        elements: where each friction element acts.
        weight: square roots of the weights: residuals times them have unit noise, shape (r,).
        basis: orthonormal columns that span the weighted regressor, shape (r, p).
        rest: weighted torque less its projection on the basis, shape (r,).
        shared: of pairs of elements that act on a joint together, the places of their common rows in each.
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
        """Return inner products of all elements' columns, without what the regressor explains.

        The columns of an element are those of LINEAR, then their derivatives by each free parameter: k in all.

        Returns:
            Of columns with columns, shape (k, k), and with the torque, shape (k,), and where each element's begin.
        """
        blocks = [self._columns(e, shape) for e, shape in enumerate(shapes)]
        edges = np.cumsum([0, *(block.values.shape[1] for block in blocks)])
        places = [slice(*pair) for pair in pairwise(edges)]
        projected = np.hstack([block.projected for block in blocks])
        gram = -projected.T @ projected
        for block, mine in zip(blocks, places, strict=True):
            gram[mine, mine] += block.values.T @ block.values
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
        result, rows = np.zeros(len(self.weight)), self.elements[element].rows
        if name in LINEAR:
            result[rows] = self._columns(element, shapes[element]).values[:, LINEAR.index(name)]
        else:
            shape = shapes[element].opened(name)
            place = len(LINEAR) * (1 + shape.free.index(name))
            result[rows] = self._columns(element, shape).values[:, place : place + len(LINEAR)] @ linear[element]
        return result

    def tangent(self, fit: SeparableFit, inner: Sequence[Key]) -> Array:
        """Return the columns of the whole model, without weights and linear around a fit, shape (r, q).

        Args:
            fit: around which.
            inner: the friction's parameters, whose columns follow the regressor. Those of non-linear parameters belong
                to their changes.
        """
        return np.hstack([self.problem.regressor, self._friction(fit, inner) / self.weight[:, None]])

    def _friction(self, fit: SeparableFit, inner: Sequence[Key]) -> Array:
        columns = [self.column(fit.shapes, fit.linear, key) for key in inner]
        return np.stack(columns, axis=1) if columns else np.empty((len(self.weight), 0))

    def linearised(self, fit: SeparableFit) -> tuple[Array, Array]:
        """Return weighted residuals of a fit, shape (r,), and the model's tangent there, shape (r, k).

        The tangent are weighted derivatives of the torques by everything that is fitted and not at a bound, columns of
        length 1: the basis of the regressor, then friction.
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
_MIN_EIGENVALUE = 1e-10  # relative: what is less of a Gram matrix is rounding


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

    @lru_cache(1)  # residuals and derivatives are asked for at the same values, one after the other
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
    """Return which of an element's candidate shapes fits best, the other elements as they are."""

    def cost(candidate: ElementShape) -> float:
        there = [*shapes[:element], candidate, *shapes[element + 1 :]]
        # Costs need no derivatives, of which a bristle has one more deflection each.
        return _projected(weighted, [replace(shape, fixed=frozenset(FITTED)) for shape in there], ())[1]

    return min(candidates, key=cost)


def _projected(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], only: Sequence[int]
) -> tuple[Array, float, Array]:
    """Return the best linear parameters, (n_el, 3), the sum of squares that they leave, and Kaufman's derivatives.

    These, by the t free parameters of the elements `only`, and behind them the residuals have shape (t + 1, t + 1): up
    to a rotation, which changes no sum of squares.
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
    # A root of the inner products of derivatives and residual, less what the active linear columns take.
    active, values = columns[values > 0.0], values[values > 0.0]
    mixed = gram[active] @ slopes
    inverse = np.linalg.pinv(gram[np.ix_(active, active)], rcond=_MIN_EIGENVALUE, hermitian=True)
    cost = max(float(weighted.rest @ weighted.rest) - float(product[active] @ values), 0.0)
    table = np.empty((len(free) + 1,) * 2)
    table[:-1, :-1] = slopes.T @ gram @ slopes - mixed.T @ inverse @ mixed
    # The derivatives of the residual are minus those of the torque; the residual has no part in active columns.
    table[-1, :-1] = table[:-1, -1] = mixed.T @ values - slopes.T @ product
    table[-1, -1] = cost
    scale = np.sqrt(np.maximum(np.diag(table), 1e-300))
    size, vectors = np.linalg.eigh(table / np.outer(scale, scale))
    return linear, cost, np.asarray((vectors * np.sqrt(np.maximum(size, 0.0))).T * scale)


def nonnegative(gram: Array, product: Array) -> Array:
    """Return the x >= 0 that minimises x' gram x / 2 - product' x, shape (k,), of a Gram matrix of shape (k, k)."""
    # Of a column that the regressor explains, as of a joint that turns one way, rounding is left, of either sign.
    square = np.diag(gram)
    scale = np.sqrt(np.where(square > _ROUNDING * square.max(initial=0.0), square, 1.0))
    size, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    known = size > _MIN_EIGENVALUE * max(size[-1], 0.0)
    if not known.any():
        return np.zeros(len(product))
    root = np.sqrt(size[known])
    target = (vectors[:, known] / root).T @ (product / scale)
    return np.asarray(nnls((vectors[:, known] * root).T, target)[0] / scale)
