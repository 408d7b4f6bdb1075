"""Separable non-linear least squares: the linear parameters are eliminated, SciPy optimises the others.

Variable projection (Golub and Pereyra 1973) with Kaufman's derivatives (1975). All joints and elements are fitted
together, so that a friction parameter answers for the inertias with which it is correlated. The search works on inner
products of columns: an element has rows on its own joints only, and a change of one element leaves those of the others.

The rows of a problem with their weights, and inner products of friction columns in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.law import (
    COULOMB,
    DAMPING,
    FITTED,
    LINEAR,
    VISCOUS,
    ElementRows,
    ElementShape,
    Part,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_MAX_EVALUATIONS = 40
_TOLERANCE = 1e-8  # of cost and parameters
_AT_BOUND = 1e-3  # of the width of the range
_ROUNDING = 1e-13  # of a column's square over the greatest
_MIN_EIGENVALUE = 1e-10  # relative: what is less of a Gram matrix is rounding


@dataclass(frozen=True, eq=False)
class SeparableFit:
    """A model fitted to weighted rows.

    Attributes:
        shapes: of the elements.
        linear: tau_c, c2 and c1 of each, none negative, shape (n_el, 3).
        cost: sum of the squared weighted residuals.
        at_bound: names of the free parameters of each element that lie on a bound.
    """

    shapes: tuple[ElementShape, ...]
    linear: Array
    cost: float
    at_bound: tuple[frozenset[str], ...]

    def inner(self) -> tuple[tuple[int, str], ...]:
        """Return element and name of everything in the friction that is fitted and not at a bound."""
        found = []
        for e, (shape, values) in enumerate(zip(self.shapes, self.linear, strict=True)):
            found += [(e, name) for name, value in zip(LINEAR, values, strict=True) if value > 0.0]
            # Without a torque that they shape, such parameters have no meaning.
            found += [(e, name) for name in shape.free if name not in self.at_bound[e] and values[_SHAPED[name]] > 0.0]
        return tuple(found)


_SHAPED = {"alpha": VISCOUS, "rise": COULOMB, "omega_s": COULOMB, "delta": COULOMB, "stiffness": COULOMB}
"""Which linear parameter's torque each of the others shapes."""


def fit_shapes(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], only: Sequence[int] | None = None
) -> SeparableFit:
    """Fit linear and free non-linear parameters.

    Args:
        weighted: the rows.
        shapes: to start from.
        only: elements whose non-linear parameters are fitted; by default all.
    """
    search = _Search(weighted, tuple(shapes), range(len(shapes)) if only is None else only)
    start, lower, upper = search.start()
    if len(start):
        found = least_squares(
            search.residual, np.clip(start, lower, upper), search.jacobian, (lower, upper),
            ftol=_TOLERANCE, xtol=_TOLERANCE, max_nfev=_MAX_EVALUATIONS,
        )  # fmt: skip
        search.move(np.asarray(found.x))
    at_bound = tuple(_at_bound(weighted, e, shape) for e, shape in enumerate(search.shapes))
    return SeparableFit(search.shapes, search.linear, search.cost, at_bound)


def _at_bound(weighted: WeightedProblem, element: int, shape: ElementShape) -> frozenset[str]:
    """Return the free parameters of a shape that lie on a bound of their range."""
    found = set()
    for name, value in zip(shape.free, shape.values.tolist(), strict=True):
        low, high = weighted.bounds(element, name)
        if min(value - low, high - value) < _AT_BOUND * (high - low):
            found.add(name)
    return frozenset(found)


def best_start(
    weighted: WeightedProblem, shapes: Sequence[ElementShape], element: int, candidates: Sequence[ElementShape]
) -> ElementShape:
    """Return which of an element's candidate shapes fits best, the other elements as they are."""
    # Costs need no derivatives, of which a bristle has one more deflection each.
    held = [replace(shape, fixed=frozenset(FITTED)) for shape in shapes]
    costs = [
        _Search(weighted, (*held[:element], replace(one, fixed=frozenset(FITTED)), *held[element + 1 :]), ()).cost
        for one in candidates
    ]
    return candidates[int(np.argmin(costs))]


class _Search:
    """Residuals and derivatives at free parameters, up to a rotation, which changes no sum of squares."""

    def __init__(self, weighted: WeightedProblem, shapes: tuple[ElementShape, ...], only: Sequence[int]) -> None:
        self._weighted = weighted
        self._only = only
        self._at: Array | None = None
        self.shapes = shapes
        self._solve()

    def start(self) -> tuple[Array, Array, Array]:
        """Return free parameters of the shapes, and their bounds, each shape (t,)."""
        values = np.concatenate([np.empty(0), *(self.shapes[e].values for e in self._only)])
        pairs = [self._weighted.bounds(e, name) for e in self._only for name in self.shapes[e].free]
        return values, np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    def move(self, x: Array) -> None:
        """Solve at other free parameters, unless they are those of the last time."""
        if self._at is not None and np.array_equal(self._at, x):
            return
        shapes, rest = list(self.shapes), x
        for e in self._only:
            count = len(shapes[e].free)
            shapes[e], rest = shapes[e].with_values(rest[:count]), rest[count:]
        self.shapes = tuple(shapes)
        self._at = x.copy()
        self._solve()

    def residual(self, x: Array) -> Array:
        """Return residuals with the best linear parameters, shape (t + 1,)."""
        self.move(x)
        return np.asarray(self._root[:, -1])

    def jacobian(self, x: Array) -> Array:
        """Return Kaufman's derivatives of the residuals, shape (t + 1, t)."""
        self.move(x)
        return np.asarray(self._root[:, :-1])

    def _solve(self) -> None:
        gram, product = self._weighted.gram(self.shapes)
        linear = [(e, place) for e, shape in enumerate(self.shapes) for place in _places(shape)]
        width = len(LINEAR)
        offsets = np.cumsum([0, *(width * (1 + len(shape.free)) for shape in self.shapes)])
        columns = np.array([offsets[e] + place for e, place in linear])
        values = _nonnegative(gram[np.ix_(columns, columns)], product[columns])
        self.linear = np.zeros((len(self.shapes), len(LINEAR)))
        for (e, place), value in zip(linear, values, strict=True):
            self.linear[e, place] = value
        slopes = []
        for e in self._only:
            for k in range(len(self.shapes[e].free)):
                slope = np.zeros(len(gram))
                slope[offsets[e] + width * (1 + k) : offsets[e] + width * (2 + k)] = self.linear[e]
                slopes.append(slope)
        active = columns[values > 0.0]
        self._reduce(gram, product, active, values[values > 0.0], np.array(slopes).reshape(-1, len(gram)).T)

    def _reduce(self, gram: Array, product: Array, active: Array, values: Array, slopes: Array) -> None:
        """Keep a root of the inner products of derivatives and residual, less what the linear columns take."""
        mixed = gram[active] @ slopes
        inverse = np.linalg.pinv(gram[np.ix_(active, active)], rcond=_MIN_EIGENVALUE, hermitian=True)
        inner = slopes.T @ gram @ slopes - mixed.T @ inverse @ mixed
        # The derivatives of the residual are minus those of the torque; the residual has no part in active columns.
        with_residual = -(slopes.T @ product - mixed.T @ values)
        self.cost = max(self._weighted.power - float(product[active] @ values), 0.0)
        table = np.block([[inner, with_residual[:, None]], [with_residual[None, :], np.array([[self.cost]])]])
        scale = np.sqrt(np.maximum(np.diag(table), 1e-300))
        size, vectors = np.linalg.eigh(table / np.outer(scale, scale))
        self._root = (vectors * np.sqrt(np.maximum(size, 0.0))).T * scale


def _places(shape: ElementShape) -> tuple[int, ...]:
    """Return which linear parameters a shape has."""
    return (COULOMB, VISCOUS, DAMPING) if Part.DAMPING in shape.parts else (COULOMB, VISCOUS)


def _nonnegative(gram: Array, product: Array) -> Array:
    """Return the x >= 0 that minimises x' gram x / 2 - product' x."""
    # Of a column that the regressor explains, as of a joint that turns one way, rounding is left, of either sign.
    square = np.diag(gram)
    scale = np.sqrt(np.where(square > _ROUNDING * square.max(initial=0.0), square, 1.0))
    size, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    known = size > _MIN_EIGENVALUE * max(size[-1], 0.0)
    if not known.any():
        return np.zeros(len(product))
    root = (vectors[:, known] * np.sqrt(size[known])).T
    target = (vectors[:, known] / np.sqrt(size[known])).T @ (product / scale)
    return np.asarray(nnls(root, target)[0] / scale)


_RANGES = {"alpha": (0.2, 2.0), "rise": (0.0, 1.5), "delta": (0.5, 2.5)}
_STRIBECK_OVER_SPEED = (1.0, 0.1)  # Stribeck velocity: over the least and over the greatest speed with data
_LONGEST_PRESLIDING = 0.3  # rad, 1 / stiffness
_CACHED_SHAPES = 6  # shapes of an element whose inner products are kept


@dataclass(frozen=True, eq=False)
class _Columns:
    """Weighted columns of an element, and then their derivatives, shape (s, k), with their inner products.

    Attributes:
        values: on the element's rows, shape (s, k).
        projected: inner products with the basis, shape (p, k).
        product: with the torque that the basis leaves, shape (k,).
    """

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
    shared: dict[tuple[int, int], tuple[NDArray[np.intp], NDArray[np.intp]]]
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

    @property
    def power(self) -> float:
        """Return the sum of squares that the regressor alone leaves."""
        return float(self.rest @ self.rest)

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

    def gram(self, shapes: Sequence[ElementShape]) -> tuple[Array, Array]:
        """Return inner products of all elements' columns, without what the regressor explains.

        The columns of an element are those of LINEAR, then their derivatives by each free parameter: k in all.

        Returns:
            Of columns with columns, shape (k, k), and with the torque, shape (k,).
        """
        blocks = [self._columns(e, shape) for e, shape in enumerate(shapes)]
        edges = np.cumsum([0, *(block.values.shape[1] for block in blocks)])
        projected = np.hstack([block.projected for block in blocks])
        gram = -projected.T @ projected
        for e, block in enumerate(blocks):
            mine = slice(edges[e], edges[e + 1])
            gram[mine, mine] += block.values.T @ block.values
        for (e, f), (first, second) in self.shared.items():
            product = blocks[e].values[first].T @ blocks[f].values[second]
            mine, its = slice(edges[e], edges[e + 1]), slice(edges[f], edges[f + 1])
            gram[mine, its] += product
            gram[its, mine] += product.T
        return gram, np.concatenate([block.product for block in blocks])

    def column(self, shapes: Sequence[ElementShape], linear: Array, element: int, name: str) -> Array:
        """Return the weighted derivative of the torque by a parameter, shape (r,).

        Args:
            shapes: of the elements.
            linear: tau_c, c2, c1 of each, shape (n_el, 3).
            element: whose parameter.
            name: in LINEAR or a parameter of the shape, as the fit writes it, which need not be free.
        """
        shape = shapes[element] if name in LINEAR else shapes[element].opened(name)
        values = self._columns(element, shape).values
        result = np.zeros(len(self.weight))
        if name in LINEAR:
            own = values[:, LINEAR.index(name)]
        else:
            place = len(LINEAR) * (1 + shape.free.index(name))
            own = values[:, place : place + len(LINEAR)] @ linear[element]
        result[self.elements[element].rows] = own
        return result

    def _columns(self, element: int, shape: ElementShape) -> _Columns:
        kept = self._kept.setdefault(element, {})
        if shape not in kept:
            while len(kept) >= _CACHED_SHAPES:
                kept.pop(next(iter(kept)))
            rows = self.elements[element]
            columns, slopes = rows.columns(shape)
            values = np.hstack([columns, *slopes.values()]) * self.weight[rows.rows, None]
            projected = self.basis[rows.rows].T @ values
            kept[shape] = _Columns(values, projected, values.T @ self.rest[rows.rows])
        return kept[shape]
