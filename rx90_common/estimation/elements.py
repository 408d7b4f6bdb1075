"""Rows on which friction elements act: the problem of a fit for a law of each element."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.estimation.fit import Fit, Problem, Projected, fit, of_groups
from rx90_common.estimation.law import Law, Speeds


class ElementRows(Protocol):
    """The rows that one element acts on."""

    @property
    def rows(self) -> Index:
        """Return their numbers, shape (s,)."""

    @property
    def speeds(self) -> Speeds:
        """Return the speeds with data."""

    def torque(self, law: Law, x: Array) -> tuple[Array, Array]:
        """Return what the element contributes to its rows, (s,), and its derivatives by the parameters, (s, k)."""


class SteadyRows(NamedTuple):
    """Rows of an element that slides at a constant velocity.

    Attributes:
        rows: their numbers, shape (s,).
        velocity: of the element, rad/s, shape (s,).
        gain: what a row has per Nm of the element's torque, shape (s,).
        speeds: with data.
    """

    rows: Index
    velocity: Array
    gain: Array
    speeds: Speeds

    def torque(self, law: Law, x: Array) -> tuple[Array, Array]:
        """Return the steady torque and its derivatives, times the gain."""
        torque, slopes = law.curve(self.velocity, x)
        return self.gain * torque, self.gain[:, None] * slopes


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """r rows of an arm or a rig: everything but the law of friction.

    Attributes:
        target: shape (r,).
        linear: columns of parameters without friction, shape (r, p).
        elements: the rows of each.
        group: of equal noise, shape (r,).
        block: of independent errors, shape (r,).
        prior: as in `Problem`.
    """

    target: Array
    linear: Array
    elements: Sequence[ElementRows]
    group: Index
    block: Index
    prior: Array

    def problem(self, laws: Sequence[Law], start: Array | None = None) -> Problem:
        """Return the problem of one law for each element; its parameters stand one element after the other."""
        pairs = list(zip(laws, self.elements, strict=True))
        lower, upper = np.hstack([law.bounds(element.speeds) for law, element in pairs])
        first = [law.starts(element.speeds)[0] for law, element in pairs]

        def model(x: Array) -> tuple[Array, Array]:
            total = np.zeros(len(self.target))
            slopes = np.zeros((len(self.target), len(x)))
            for number, place in enumerate(places(laws)):
                torque, own = self._torque(number, laws[number], x[place].tobytes())
                total[self.elements[number].rows] += torque
                slopes[self.elements[number].rows, place] = own
            return total, slopes

        return Problem(
            target=self.target,
            linear=self.linear,
            model=model,
            start=np.concatenate(first) if start is None else start,
            lower=lower,
            upper=upper,
            group=self.group,
            block=self.block,
            prior=self.prior,
            spread=np.full(len(lower), np.inf),
        )

    @cached_property
    def _torque(self) -> Callable[[int, Law, bytes], tuple[Array, Array]]:
        """Return the function for an element's torque and slopes; the last ones are kept, as most do not change."""
        elements = (
            self.elements
        )  # not self, which would then wait for the garbage collector with its rows

        def torque(number: int, law: Law, x: bytes) -> tuple[Array, Array]:
            return elements[number].torque(law, np.frombuffer(x))

        return lru_cache(len(elements))(torque)


def places(laws: Sequence[Law]) -> list[slice]:
    """Return where the parameters of each element's law stand among all."""
    ends = np.cumsum([len(law.names) for law in laws]).tolist()
    return [slice(end - len(law.names), end) for law, end in zip(laws, ends, strict=True)]


Known = Sequence[Mapping[str, float]]
"""Fitted parameters of each element by name."""


def fitted_values(laws: Sequence[Law], x: Array) -> list[dict[str, float]]:
    """Return the fitted parameters of each element by name."""
    return [
        dict(zip(law.names, x[place].tolist(), strict=True))
        for law, place in zip(laws, places(laws), strict=True)
    ]


def fit_laws(
    rows: FrictionRows, laws: Sequence[Law], weight: Array | None = None, known: Known | None = None
) -> Fit:
    """Return the fit of one law for each element.

    Args:
        rows: the equations.
        laws: of the elements.
        weight: as in `fit`.
        known: parameters to begin with; the shapes that are missing there are sought, element by element.
    """
    begin = find_start(rows, laws, weight, known)
    return fit(rows.problem(laws, begin), weight)


def find_start(
    rows: FrictionRows, laws: Sequence[Law], weight: Array | None, known: Known | None
) -> Array:
    """Return a start of all parameters, shape (q,): each element's shapes are sought with the others' as they are."""
    problem = rows.problem(laws)
    if weight is None:
        spread = of_groups(problem, rows.target, np.std)
        weight = 1.0 / np.maximum(spread, 1e-12)[rows.group] ** 2
    projected = Projected(problem, weight)
    known = [{} for _ in laws] if known is None else known
    starts = [
        law.starts(element.speeds, own)
        for law, element, own in zip(laws, rows.elements, known, strict=True)
    ]
    x = np.concatenate([shapes[0] for shapes in starts])
    are_sizes = np.array([name in law.sizes for law in laws for name in law.names], dtype=np.bool_)
    for place, shapes in zip(places(laws), starts, strict=True):
        candidates = []
        for shape in shapes:
            candidate = x.copy()
            candidate[place] = shape
            candidates.append(candidate)
        x = projected.best_start(candidates, are_sizes)
    return x
