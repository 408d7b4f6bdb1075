"""The rows of a problem with their weights, and inner products of friction columns in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.columns import ElementRows
from rx90_emulator.identification.excitation.friction.law import LINEAR, ElementShape
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_RANGES = {"alpha": (0.2, 2.0), "rise": (0.0, 1.5), "delta": (0.5, 2.5)}
_STRIBECK = (1.0, 0.1)  # Stribeck velocity: over the least and over the greatest speed with data
_LONGEST_PRESLIDING = 0.3  # rad, 1 / stiffness
_KEPT = 6  # shapes of an element whose inner products are kept


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
        least = _STRIBECK[0] * max(low, 1e-4)
        return float(np.log(least)), float(np.log(max(_STRIBECK[1] * high, 2.0 * least)))

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
            while len(kept) >= _KEPT:
                kept.pop(next(iter(kept)))
            rows = self.elements[element]
            columns, slopes = rows.columns(shape)
            values = np.hstack([columns, *slopes.values()]) * self.weight[rows.rows, None]
            projected = self.basis[rows.rows].T @ values
            kept[shape] = _Columns(values, projected, values.T @ self.rest[rows.rows])
        return kept[shape]
