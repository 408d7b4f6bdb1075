"""Choose the law of each element by its error in blocks of data that the fit did not see.

One part imitates another that is missing, so that neither can be judged alone: all combinations of parts are fitted,
each to all elements at once, and each block of rows is predicted by the fit to the other blocks. An element gets the
smallest combination from which no larger one lowers the squares on its rows by more than one standard error over the
blocks (the one-standard-error rule of Breiman et al. 1984). A combination with a parameter at a bound is none. A rise
whose omega_s is near the top speed is a slope, which the viscous exponent has as well: it stays only where friction
falls with speed.

Rise and exponent imitate each other: both at once, or the second one of them, need two standard errors. An exponent
without a rise is that of the lubricant, which all gears of an arm share: where it helps all elements together by the
rule, an element gets it if its own squares fall at all.

A bristle acts after a reversal, as a rise does, and each alone imitates the other: it is tried last, where a rise was
found.

Leaving out a block takes one Gauss-Newton step from the fit to all rows, which is exact for linear parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq

from rx90_common.base.arrays import Array, Index
from rx90_common.estimation.elements import (
    FrictionRows,
    Known,
    fit_laws,
    fitted_values,
    places,
)
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import LEAST_STRIBECK, MOST_STRIBECK, Law, Part

STEEP = 0.25
"""Of the top speed: omega_s up to which a rise is one, and no slope over the whole range of speeds."""
STANDARD_ERRORS = 1.0
"""Of a gain, that it must exceed. With two, sweeps of few plateaus lose rises that they have."""
BOTH_ERRORS = 2.0
"""The same for a rise and an exponent together, which imitate each other."""
MOST_FOLDS = 20
"""Blocks are joined to so many folds at most."""


_OWN: dict[Part, tuple[str, ...]] = {
    Part.STRIBECK: ("rise", "omega_s", "tau_c"),
    Part.STRIBECK_EXPONENT: ("delta", "tau_c"),
    Part.EXPONENT: ("alpha", "c2", "tau_c"),
    Part.BRISTLE: ("stiffness",),
}
"""The parameters by which a part is judged. An exponent near its lower bound, or a rise, may stand in for tau_c."""


class Gain(NamedTuple):
    """What an element gains by a richer law.

    Attributes:
        share: by which the held-out RMS error of the element's rows falls, of this error.
        deviation: standard error of the share.
        bound: the name of a parameter that ended at a bound; "" if none did.
        errors: how many standard errors are enough.
        together: whether all elements together gain enough by an exponent, which they share.
    """

    share: float
    deviation: float
    bound: str = ""
    errors: float = STANDARD_ERRORS
    together: bool = False

    @property
    def kept(self) -> bool:
        """Return whether the element keeps what is richer."""
        is_clear = self.share > self.errors * self.deviation
        return bool(not self.bound and (is_clear or (self.together and self.share > 0.0)))

    @property
    def reason(self) -> str:
        """Return why it does or does not, in words."""
        if self.bound:
            return f"{self.bound} ends at a bound"
        return (
            f"left-out error {100.0 * self.share:.2g} % less, with a standard error of "
            f"{100.0 * self.deviation:.2g} %"
        )


class Choice(NamedTuple):
    """The chosen laws, and their fit."""

    laws: tuple[Law, ...]
    fit: Fit


Parts = frozenset[Part]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A fit of one law for each element, and the parts that may not end at a bound."""

    laws: list[Law]
    fit: Fit
    parts: Parts

    @cached_property
    def squares(self) -> Array:
        """Return the squares of the held-out errors, shape (r,)."""
        return held_out_squares(self.fit)

    @property
    def values(self) -> list[dict[str, float]]:
        """Return the fitted parameters of each element by name."""
        return fitted_values(self.laws, self.fit.x)

    def bound(self, number: int) -> str:
        """Return the name of a parameter of an element's parts that ends at a bound; "" if there is none."""
        law = self.laws[number]
        place = places(self.laws)[number]
        names = [
            _at_bound(law, part, self.fit, place) for part in Part if part in law.parts & self.parts
        ]
        return next(filter(None, names), "")


def choose(
    rows: FrictionRows,
    parts: Sequence[Part],
    laws: Sequence[Law],
) -> Choice:
    """Choose the parts of each element's law.

    Args:
        rows: the equations.
        parts: to try.
        laws: that each element has at least, such as Coulomb and viscous friction.
    """
    candidates: dict[Parts, _Fitted] = {}
    weight = None
    for some in reversed(_combinations(parts)):
        richer_laws = [replace(law, parts=law.parts | some) for law in laws]
        candidates[some] = _Fitted(richer_laws, fit_laws(rows, richer_laws, weight), some)
        weight = candidates[some].fit.weight
    chosen = []
    known = []
    for number in range(len(laws)):
        best = candidates[_best(rows, number, candidates)]
        chosen.append(best.laws[number])
        known.append(best.values[number])
    choice = Choice(tuple(chosen), fit_laws(rows, chosen, None, known))
    choice = without_bound_parts(rows, choice)
    tried = [number for number, law in enumerate(choice.laws) if Part.STRIBECK in law.parts]
    if Part.BRISTLE not in parts or not tried:
        return choice
    return _with_bristles(rows, choice, tried)


def _combinations(parts: Sequence[Part]) -> list[Parts]:
    """Return the combinations of steady parts, the smallest first; a rise's exponent needs the rise."""
    steady = [part for part in parts if part is not Part.BRISTLE]
    sets = [
        frozenset(some) for count in range(len(steady) + 1) for some in combinations(steady, count)
    ]
    lone = Part.STRIBECK in steady
    return [
        some
        for some in sets
        if not (lone and Part.STRIBECK_EXPONENT in some and Part.STRIBECK not in some)
    ]


def _best(rows: FrictionRows, number: int, candidates: dict[Parts, _Fitted]) -> Parts:
    """Return the parts of an element: from none on, the best of the smallest larger combinations that help."""
    element_rows = rows.elements[number].rows
    squares = {
        parts: float(candidate.squares[element_rows].sum())
        for parts, candidate in candidates.items()
    }
    best: Parts = frozenset()
    for count in range(1, 1 + max(map(len, candidates))):
        larger = [parts for parts in candidates if len(parts) == count and parts > best]
        helpful = [
            parts
            for parts in larger
            if _gain(rows, number, candidates[best], candidates[parts]).kept
        ]
        best = min(helpful, key=lambda parts: squares[parts], default=best)
    return best


def _gain(rows: FrictionRows, number: int, before: _Fitted, after: _Fitted) -> Gain:
    element_rows = rows.elements[number].rows
    squares = before.squares[element_rows], after.squares[element_rows]
    gain = Gain(*held_out_gain(rows.block[element_rows], *squares), after.bound(number))
    errors = needed_errors(before.laws[number].parts, after.laws[number].parts)
    if errors > STANDARD_ERRORS:
        return gain._replace(errors=errors)
    if after.parts - before.parts == {Part.EXPONENT}:
        total, error = held_out_gain(rows.block, before.squares, after.squares)
        return gain._replace(together=total > STANDARD_ERRORS * error)
    return gain


def needed_errors(before: Parts, after: Parts) -> float:
    """Return how many standard errors a gain by richer parts must exceed."""
    both = {Part.STRIBECK, Part.EXPONENT}
    return BOTH_ERRORS if after >= both and not before >= both else STANDARD_ERRORS


def _with_bristles(rows: FrictionRows, choice: Choice, tried: Sequence[int]) -> Choice:
    """Return the choice with a bristle for each of some elements that predicts better with it."""
    laws = list(choice.laws)
    for number in tried:
        laws[number] = replace(laws[number], parts=laws[number].parts | {Part.BRISTLE})
    before = _Fitted(list(choice.laws), choice.fit, frozenset())
    after = _Fitted(
        [*laws], fit_laws(rows, laws, choice.fit.weight, before.values), frozenset(Part)
    )
    for number in tried:
        if not _gain(rows, number, before, after).kept:
            laws[number] = choice.laws[number]
    return choice if tuple(laws) == choice.laws else _simpler(rows, laws, after.values)


def without_bound_parts(rows: FrictionRows, choice: Choice) -> Choice:
    """Return the choice without the parts that have a parameter at a bound, fitted anew, the last part first."""
    laws = []
    for law, place in zip(choice.laws, places(choice.laws), strict=True):
        bad = [
            part for part in Part if part in law.parts and _at_bound(law, part, choice.fit, place)
        ]
        laws.append(replace(law, parts=_less(law.parts, bad[-1])) if bad else law)
    if tuple(laws) == choice.laws:
        return choice
    return _simpler(rows, laws, fitted_values(choice.laws, choice.fit.x))


def _simpler(rows: FrictionRows, laws: Sequence[Law], fitted: Known) -> Choice:
    """Return the choice of simpler laws, fitted from parameters of the richer ones, without parts at a bound."""
    known = [{name: own[name] for name in law.names} for law, own in zip(laws, fitted, strict=True)]
    return without_bound_parts(rows, Choice(tuple(laws), fit_laws(rows, laws, known=known)))


def _at_bound(law: Law, part: Part, result: Fit, place: slice) -> str:
    """Return the name of a parameter of a part that ends at a bound which it may not end at; "" if there is none."""
    falls = part is Part.STRIBECK and _falls(law, result, place)
    for number, name in enumerate(law.names, place.start):
        if name.startswith(_OWN[part]):
            top = math.exp(result.problem.upper[number]) / MOST_STRIBECK
            slope = name == "omega_s" and math.exp(result.x[number]) > STEEP * top
            if (slope or result.at_bound[number]) and not (
                falls and (slope or name.startswith("tau_c"))
            ):
                return name
    return ""


def _falls(law: Law, result: Fit, place: slice) -> bool:
    """Return whether the friction of an element with a rise is less at its top speed than at its least."""
    number = place.start + law.names.index("omega_s")
    low = math.exp(result.problem.lower[number]) / LEAST_STRIBECK
    high = math.exp(result.problem.upper[number]) / MOST_STRIBECK
    slow, fast = law.curve(np.array([low, high]), result.x[place])[0]
    return bool(fast < slow)


def _less(parts: Parts, part: Part) -> Parts:
    """Return parts without one; the Stribeck exponent goes with the rise."""
    return parts - ({part, Part.STRIBECK_EXPONENT} if part is Part.STRIBECK else {part})


def held_out_squares(result: Fit) -> Array:
    """Return the weighted square of each row's error when the rows of its fold are left out, shape (r,)."""
    columns, prior, _ = result.scaled()
    information = columns.T @ columns + prior
    error = np.sqrt(result.weight) * result.residual
    fold = np.unique(result.problem.block, return_inverse=True)[1] % MOST_FOLDS
    squares = np.zeros(len(error))
    for number in np.unique(fold):
        rows = fold == number
        own = columns[rows]
        step = lstsq(information - own.T @ own, own.T @ error[rows], cond=1e-10)[0]
        squares[rows] = (error[rows] + own @ step) ** 2
    return squares


def held_out_gain(block: Index, before: Array, after: Array) -> tuple[float, float]:
    """Return by which share the RMS error falls, and its standard error over the blocks.

    Args:
        block: number of each row's block, shape (s,).
        before: held-out squares of the simpler law, shape (s,).
        after: of the other one, shape (s,).
    """
    gain = np.bincount(np.unique(block, return_inverse=True)[1], before - after)
    total = max(float(before.sum()), np.finfo(np.float64).tiny)
    deviation = np.sqrt(len(gain)) * float(np.std(gain, ddof=1)) if len(gain) > 1 else np.inf
    return 0.5 * float(gain.sum()) / total, 0.5 * deviation / total
