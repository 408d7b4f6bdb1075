"""Choose the law of each element by its error in blocks of data that the fit did not see.

The parts are tried one after the other, on all elements at once: with a part, each block of rows is predicted by the
fit to the other blocks. An element keeps the part if that lowers the squares on its rows by more than one standard
error over the blocks (the one-standard-error rule of Breiman et al. 1984), and if no parameter of the law ends at a
bound: such a part imitates something else. Only omega_s may end at the top speed, where friction falls with speed.

Leaving out a block takes one Gauss-Newton step from the fit to all rows, which is exact for linear parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lstsq

from rx90_common.base.arrays import Array
from rx90_common.estimation.elements import FrictionRows, fit_laws, fitted_values, places
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import Law, Part

MOST_FOLDS = 20
"""Blocks are joined to so many folds at most."""


@dataclass(frozen=True)
class Trial:
    """What a part brings an element.

    Attributes:
        element: its number.
        part: that was tried.
        gain: by which the held-out RMS error of the element's rows falls, as a share of it.
        deviation: standard error of the gain.
        bound: the name of a parameter that ended at a bound; "" if none did.
    """

    element: int
    part: Part
    gain: float
    deviation: float

    bound: str = ""

    @property
    def kept(self) -> bool:
        """Return whether the element keeps the part."""
        return bool(self.gain > self.deviation and not self.bound)

    @property
    def reason(self) -> str:
        """Return why it does or does not, in words."""
        if self.bound:
            return f"{self.bound} ends at a bound"
        return f"left-out error {100.0 * self.gain:.2g} % less, with a standard error of {100.0 * self.deviation:.2g} %"


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen laws, their fit, and the trials."""

    laws: tuple[Law, ...]
    fit: Fit
    trials: tuple[Trial, ...]


def choose(
    rows: FrictionRows,
    parts: Sequence[Part],
    laws: Sequence[Law],
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Choose the parts of each element's law.

    Args:
        rows: the equations.
        parts: to try, in this order.
        laws: to begin with, such as Coulomb and viscous friction for each element.
        progress: called with the name of each part before its trial.
    """
    chosen = list(laws)
    best = fit_laws(rows, chosen)
    weight = best.weight
    trials = []
    for part in parts:
        progress(part.value)
        candidates = [_with(law, part) for law in chosen]
        if candidates == chosen:
            continue
        richer = fit_laws(rows, candidates, weight, fitted_values(chosen, best.x))
        before = held_out_squares(best)
        after = held_out_squares(richer)
        keeps = []
        for number, place in enumerate(places(candidates)):
            if candidates[number] != chosen[number]:
                trial = _trial(rows, number, part, before, after)
                keeps.append(replace(trial, bound=_at_bound(candidates[number], richer, place)))
        trials += keeps
        kept = {trial.element for trial in keeps if trial.kept}
        if kept:
            before_it = fitted_values(chosen, best.x)
            with_it = fitted_values(candidates, richer.x)
            known = [with_it[number] if number in kept else before_it[number] for number in range(len(chosen))]
            chosen = [candidates[number] if number in kept else law for number, law in enumerate(chosen)]
            best = fit_laws(rows, chosen, weight, known)
    best = fit_laws(rows, chosen, known=fitted_values(chosen, best.x))
    return without_bound_parts(rows, Choice(tuple(chosen), best, tuple(trials)))


def without_bound_parts(rows: FrictionRows, choice: Choice) -> Choice:
    """Return the choice without the last part of each law that has a parameter at a bound, fitted anew."""
    laws = []
    for law, place in zip(choice.laws, places(choice.laws), strict=True):
        parts = law.parts
        if parts and _at_bound(law, choice.fit, place):
            last = max(parts, key=list(Part).index)
            parts = parts - {last}
        laws.append(replace(law, parts=parts))
    if tuple(laws) == choice.laws:
        return choice
    values = fitted_values(choice.laws, choice.fit.x)
    known = [{name: own[name] for name in law.names} for law, own in zip(laws, values, strict=True)]
    return without_bound_parts(rows, replace(choice, laws=tuple(laws), fit=fit_laws(rows, laws, known=known)))


def _at_bound(law: Law, result: Fit, place: slice) -> str:
    """Return the name of a parameter at a bound that it may not end at; "" if there is none."""
    problem = result.problem
    for number, name in enumerate(law.names, place.start):
        at_top = problem.upper[number] - result.x[number] < result.x[number] - problem.lower[number]
        falls = name == "omega_s" and at_top
        if result.at_bound[number] and name not in ("c2", "c1") and not falls:
            return name
    return ""


def _with(law: Law, part: Part) -> Law:
    """Return the law with one more part, or the law itself if it cannot have it."""
    if part is Part.STRIBECK_EXPONENT and Part.STRIBECK not in law.parts:
        return law
    return replace(law, parts=law.parts | {part})


def folds(result: Fit) -> Array:
    """Return the number of each row's fold, shape (r,): whole blocks, at most MOST_FOLDS."""
    number = np.unique(result.problem.block, return_inverse=True)[1]
    count = min(int(number.max(initial=0)) + 1, MOST_FOLDS)
    return np.asarray(number % count)


def held_out_squares(result: Fit) -> Array:
    """Return the weighted square of each row's error when the rows of its fold are left out, shape (r,)."""
    columns = result.columns
    prior = result.prior_information
    size = np.sqrt(np.sum(columns**2, axis=0) + np.diag(prior))
    size[size == 0.0] = 1.0
    columns /= size
    information = columns.T @ columns + prior / np.outer(size, size)
    error = np.sqrt(result.weight) * result.residual
    fold = folds(result)
    squares = np.zeros(len(error))
    for number in np.unique(fold):
        rows = fold == number
        own = columns[rows]
        step = lstsq(information - own.T @ own, own.T @ error[rows], cond=1e-10)[0]
        squares[rows] = (error[rows] + own @ step) ** 2
    return squares


def _trial(rows: FrictionRows, element: int, part: Part, before: Array, after: Array) -> Trial:
    own = rows.elements[element].rows
    block = np.unique(rows.block[own], return_inverse=True)[1]
    gain = np.bincount(block, before[own] - after[own])
    total = max(float(before[own].sum()), np.finfo(np.float64).tiny)
    deviation = np.sqrt(len(gain)) * float(np.std(gain, ddof=1)) if len(gain) > 1 else np.inf
    return Trial(element, part, 0.5 * float(gain.sum()) / total, 0.5 * deviation / total)
