"""Choose the law of each element by its error in blocks of data that the fit did not see.

All elements begin with all parts, because what one part explains another one imitates where it is missing. Then one
part after the other, the last first, is left out of all elements at once, and each block of rows is predicted by the
fit to the other blocks. An element keeps the part if that lowers the squares on its rows by more than one standard
error over the blocks (the one-standard-error rule of Breiman et al. 1984), and if none of the part's parameters ends at
a bound. A rise whose omega_s is near the top speed is a slope, which the viscous exponent has as well: it stays only
where friction falls with speed.

Leaving out a block takes one Gauss-Newton step from the fit to all rows, which is exact for linear parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lstsq

from rx90_common.base.arrays import Array, Index
from rx90_common.estimation.elements import FrictionRows, fit_laws, fitted_values, places
from rx90_common.estimation.fit import Fit
from rx90_common.estimation.law import LEAST_STRIBECK, Law, Part

STEEP = 0.25
"""Of the top speed: omega_s up to which a rise is one, and no slope over the whole range of speeds."""
MOST_FOLDS = 20
"""Blocks are joined to so many folds at most."""


_OWN: dict[Part, tuple[str, ...]] = {
    Part.STRIBECK: ("rise", "omega_s", "tau_c"),
    Part.STRIBECK_EXPONENT: ("delta", "tau_c"),
    Part.EXPONENT: ("alpha", "c2", "tau_c"),
    Part.BRISTLE: ("stiffness",),
}
"""The parameters by which a part is judged. An exponent near its lower bound, or a rise, may stand in for tau_c."""


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
        parts: to try, in the order of their plausibility: the last is left out first.
        laws: that each element has at least, such as Coulomb and viscous friction.
        progress: called with the name of each part before its trial.
    """
    chosen = list(laws)
    for part in parts:
        chosen = [replace(law, parts=law.parts | {part}) for law in chosen]
    progress("all parts")
    best = fit_laws(rows, chosen)
    weight = best.weight
    trials = []
    for part in reversed(parts):
        progress(part.value)
        candidates = [_without(law, part) for law in chosen]
        simpler = fit_laws(rows, candidates, weight, _known(chosen, candidates, best))
        error = held_out_squares(best)
        simpler_error = held_out_squares(simpler)
        kept = []
        for number, place in enumerate(places(chosen)):
            trial = _trial(rows, number, part, simpler_error, error)
            trial = replace(trial, bound=_at_bound(chosen[number], part, best, place))
            trials.append(trial)
            kept.append(chosen[number] if trial.kept else _simpler(chosen[number], candidates[number], trial))
        if kept != chosen:
            best = fit_laws(rows, kept, weight, _known(chosen, kept, best))
            chosen = kept
    best = fit_laws(rows, chosen, known=fitted_values(chosen, best.x))
    return without_bound_parts(rows, Choice(tuple(chosen), best, tuple(trials)))


def _simpler(law: Law, without: Law, trial: Trial) -> Law:
    """Return the law of an element that does not keep a part: of a rise that helps, its exponent goes first."""
    exponent = trial.part is Part.STRIBECK and Part.STRIBECK_EXPONENT in law.parts
    return _without(law, Part.STRIBECK_EXPONENT) if exponent and trial.gain > trial.deviation else without


def without_bound_parts(rows: FrictionRows, choice: Choice) -> Choice:
    """Return the choice without the parts that have a parameter at a bound, fitted anew, the last part first."""
    laws = []
    for law, place in zip(choice.laws, places(choice.laws), strict=True):
        bad = [part for part in Part if part in law.parts and _at_bound(law, part, choice.fit, place)]
        laws.append(_without(law, bad[-1]) if bad else law)
    if tuple(laws) == choice.laws:
        return choice
    result = fit_laws(rows, laws, known=_known(choice.laws, laws, choice.fit))
    return without_bound_parts(rows, replace(choice, laws=tuple(laws), fit=result))


def _known(before: Sequence[Law], laws: Sequence[Law], result: Fit) -> list[dict[str, float]]:
    """Return the fitted parameters that simpler laws have, too, element by element."""
    values = fitted_values(before, result.x)
    return [{name: own[name] for name in law.names} for law, own in zip(laws, values, strict=True)]


def _at_bound(law: Law, part: Part, result: Fit, place: slice) -> str:
    """Return the name of a parameter of a part that ends at a bound which it may not end at; "" if there is none."""
    problem = result.problem
    for number, name in enumerate(law.names, place.start):
        if not name.startswith(_OWN[part]):
            continue
        bad = bool(result.at_bound[number])
        if name == "omega_s":
            low = math.exp(problem.lower[number]) / LEAST_STRIBECK
            high = math.exp(problem.upper[number])
            slow, fast = law.curve(np.array([low, high]), result.x[place])[0]
            bad |= math.exp(result.x[number]) > STEEP * high
            bad &= bool(fast >= slow)
        if bad:
            return name
    return ""


def _without(law: Law, part: Part) -> Law:
    """Return the law without a part; the Stribeck exponent goes with the rise."""
    gone = {part, Part.STRIBECK_EXPONENT} if part is Part.STRIBECK else {part}
    return replace(law, parts=law.parts - gone)


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


def _trial(rows: FrictionRows, element: int, part: Part, before: Array, after: Array) -> Trial:
    own = rows.elements[element].rows
    gain, deviation = held_out_gain(rows.block[own], before[own], after[own])
    return Trial(element, part, gain, deviation)
