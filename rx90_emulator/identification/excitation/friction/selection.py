"""Which parts the friction of each element has: those with which the model predicts better what it was not fitted to.

From Coulomb and viscous friction on, parts are tried in the order of their physical plausibility: viscous exponent,
Stribeck rise, bristle, bristle damping. A part is given to all elements at once, since a part missing on one joint
disturbs those it is coupled with; then it is taken from one element after the other that predicts as well without it.
Earlier parts of an element are judged anew with each later one, which may replace them.

A Stribeck rise and a bristle are both in the rows after a reversal, and alone each takes the other's torque for its
own: bristle, damping and rise are tried together. Asked for or not, bristles are tried where a rise shows, and where
rows of reversals fit worse than others: left out, a bristle biases all that is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.friction.cross_validation import (
    BlockDivision,
    CrossValidation,
    Linearised,
    Scored,
    TimeBlocks,
)
from rx90_emulator.identification.excitation.friction.fit import SeparableFit, WeightedProblem, best_start, fit_shapes
from rx90_emulator.identification.excitation.friction.law import (
    COULOMB,
    ElementShape,
    Part,
    element_rows,
)
from rx90_emulator.identification.excitation.least_squares import solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem


@dataclass(frozen=True)
class ModelRow:
    """One row of the table of models.

    Attributes:
        name: of the model.
        against: name of the model that it is compared with; empty for the first.
        parts: of each element, in words, beside Coulomb and viscous friction.
        parameters: how many are fitted, rigid body and friction.
        error: weighted RMS of the residuals of the fit, in noise deviations of the joints.
        relative: of each joint, RMS residual over RMS torque, shape (n,).
        relative_all: the same, of all joints together.
        by_blocks: cross-validation by blocks of time.
        by_runs: cross-validation by runs; None where there is one run.
        kept: whether the model goes on into the next comparison.
        reason: why it is kept or not.
    """

    name: str
    against: str
    parts: tuple[tuple[str, ...], ...]
    parameters: int
    error: float
    relative: tuple[float, ...]
    relative_all: float
    by_blocks: CrossValidation
    by_runs: CrossValidation | None
    kept: bool
    reason: str


Key = tuple[int, Part]

_BESIDE = {
    # Seen without it, a Stribeck rise hides an exponent below 1.
    Part.STRIBECK: frozenset({Part.EXPONENT}),
    Part.BRISTLE: frozenset({Part.STRIBECK, Part.DAMPING}),
}
"""Which parts are tried together with another one."""

STAGES = ("starts", "fit of all elements", "elements without it", "weights")
"""Of the attempt with each part."""

_START_COUNT = 5  # Stribeck velocities, and presliding distances, to start from
_START_RISE = 0.3  # to start from
_REVERSAL_MISFIT = 1.2  # RMS residual of reversals over that of other rows, from which on bristles are tried


@dataclass(frozen=True, eq=False)
class Selected:
    """The model that was selected.

    Attributes:
        weighted: the rows with their last weights.
        fit: of the model.
        rows: of the table of models.
        blocks: of the cross-validation.
        refused: why an element does not have a part that was tried on it.
    """

    weighted: WeightedProblem
    fit: SeparableFit
    rows: tuple[ModelRow, ...]
    blocks: BlockDivision
    refused: dict[Key, str]


def select_parts(
    problem: ExcitationProblem, parts: Sequence[Part], progress: Callable[[str], None] = lambda _: None
) -> Selected:
    """Try parts in the order given and keep those with which the model predicts better.

    `progress` is called with the name of each stage before it: STAGES for each of `attempts(parts)`.
    """
    search = _Selection(problem, parts)
    for part in attempts(parts):
        stages = iter([f"{part.value}: {stage}" for stage in STAGES])
        if part in parts or _wants_bristles(problem, search.now):
            search.attempt(part, lambda stages=stages: progress(next(stages)))  # type: ignore[misc]
        for stage in stages:  # of a part that no element can have
            progress(stage)
    return Selected(search.weighted, search.now.fit, tuple(search.rows), search.time.blocks, search.refused)


def attempts(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return the parts that are tried one after the other, if only where it is needed: bristles come after a rise."""
    asked = tuple(part for part in parts if part is not Part.DAMPING)
    return asked if Part.STRIBECK not in asked or Part.BRISTLE in asked else (*asked, Part.BRISTLE)


class _Selection:
    """The model so far, and the table of what was compared."""

    def __init__(self, problem: ExcitationProblem, parts: Sequence[Part]) -> None:
        self._problem = problem
        self._allowed = frozenset({*parts, Part.BRISTLE, Part.DAMPING} if Part.STRIBECK in parts else parts)
        self._elements = element_rows(problem)
        self._groups = _groups(problem)
        self.rows: list[ModelRow] = []
        self.refused: dict[Key, str] = {}
        shapes = [ElementShape() for _ in self._elements]
        flat = WeightedProblem.of(problem, self._elements, np.ones(len(problem.torque)))
        self.weighted = _reweighted(flat, fit_shapes(flat, shapes))
        fit = fit_shapes(self.weighted, shapes)
        self.time = TimeBlocks.of(problem, Linearised.of(self.weighted, fit).residual)
        self.now = self._scored(fit)
        self._add("Coulomb + viscous", self.now, None, True, "what the others are compared with")

    def attempt(self, part: Part, stage: Callable[[], None]) -> None:
        """Give a part to all elements, take it from those that do not need it, and keep it where it predicts better.

        `stage` is called before each of STAGES.
        """
        stage()
        tried = {part, *(_BESIDE.get(part, frozenset()) & self._allowed)}
        shapes = _started(self.weighted, self.now.fit.shapes, part, tried)
        given = [e for e, shape in enumerate(shapes) if part in shape.parts]
        keys = [(e, old) for e in given for old in shapes[e].parts if old is not Part.BRISTLE or old is part]
        if not keys:
            return
        stage()
        # Weights of the larger model: those of the smaller one play down the rows in which the part shows.
        fit = fit_shapes(self.weighted, shapes)
        self.weighted = _reweighted(self.weighted, fit)
        before = self._scored(fit_shapes(self.weighted, self.now.fit.shapes))
        everywhere = self._scored(fit_shapes(self.weighted, fit.shapes))
        stage()
        trimmed = self._trimmed(self._within_bounds(everywhere, part), keys)
        # Without the parts that went, others may have come to a bound.
        trimmed = self._within_bounds(trimmed, part)
        left = [e for e, shape in enumerate(trimmed.fit.shapes) if part in shape.parts]
        kept = bool(left) and trimmed.better_than(before)
        same = trimmed.fit.shapes == everywhere.fit.shapes
        if not same:
            gone = "kept on some elements, see below" if kept else "no element predicts better with it"
            self._add(f"+ {part.value}: all", everywhere, before, False, gone)
        if left:
            text = verdict(trimmed, before)
            where = "all" if len(left) == len(given) else ", ".join(self._problem.arm.element_names[e] for e in left)
            self._add(f"+ {part.value}: {where}", trimmed, before, kept, text)
            if not kept:
                self.refused |= {(e, part): text for e in left}
        if kept:
            self.now = trimmed
        stage()
        self._reweight()

    def _reweight(self) -> None:
        self.weighted = _reweighted(self.weighted, self.now.fit)
        self.now = self._within_bounds(self._scored(fit_shapes(self.weighted, self.now.fit.shapes)))

    def _scored(self, fit: SeparableFit) -> Scored:
        return Scored.of(self.weighted, fit, self.time)

    def _within_bounds(self, model: Scored, part: Part | None = None) -> Scored:
        """Return a model of which no parameter ends at a bound of its range: there it says nothing.

        A Stribeck rise is tried again with delta = 1, the exponent that literature gives; then `part`, which is being
        tried, goes, and else the part that the parameter belongs to.
        """
        while any(ended := _ended(model.fit)):
            shapes = list(model.fit.shapes)
            for e, bound in enumerate(ended):
                if bound:
                    shapes[e] = self._inside(model.fit, e, sorted(bound), part)
            model = self._scored(fit_shapes(self.weighted, shapes))
        return model

    def _inside(self, fit: SeparableFit, e: int, bound: Sequence[str], part: Part | None) -> ElementShape:
        """Return another shape for an element of which these parameters end at a bound."""
        shape = fit.shapes[e]
        if Part.STRIBECK in shape.parts and "delta" not in shape.fixed:
            begun = replace(shape, delta=1.0, fixed=shape.fixed | {"delta"}, alpha=self.now.fit.shapes[e].alpha)
            return best_start(self.weighted, fit.shapes, e, candidates(self.weighted, begun, e, Part.STRIBECK))
        tried = part if part in shape.parts else None
        own = [name for name in bound if tried is None or name in tried.shape]
        name = (own or bound)[0]
        whose = next(p for p in Part if name in p.shape)
        before = self.now.fit.shapes[e]
        beside = (
            part is not None and whose in _BESIDE.get(part, ()) and (part is Part.BRISTLE or whose not in before.parts)
        )
        gone = whose if beside else tried or whose
        self.refused[e, gone] = _why_ended(fit, e, name, self._problem.arm.element_names[e])
        return shape.without(gone) if own or beside else before

    def _trimmed(self, model: Scored, keys: Iterable[Key]) -> Scored:
        """Take parts away, the most useless first, until each that is left makes the model predict better.

        Elements that act on no joint together are judged side by side.
        """
        todo = {group: [key for key in keys if key[0] in group] for group in self._groups}
        while any(todo.values()):
            gone = []
            for group, candidates in todo.items():
                there = [(e, part) for e, part in candidates if part in model.fit.shapes[e].parts]
                useless = self._most_useless(model, there, group)
                todo[group] = [] if useless is None else [key for key in there if key != useless]
                gone += [] if useless is None else [useless]
            if gone:
                shapes = list(model.fit.shapes)
                for e, part in gone:
                    shapes[e] = shapes[e].without(part)
                model = self._scored(fit_shapes(self.weighted, shapes))
        return model

    def _most_useless(self, model: Scored, keys: Iterable[Key], group: Sequence[int]) -> Key | None:
        """Return the part without which the model predicts as well or better, by the most; None if there is none.

        The non-linear parameters of elements that act on none of the group's joints stay: they hardly change.
        """
        worst: tuple[float, Key | None] = (np.inf, None)
        for e, part in keys:
            shapes = list(model.fit.shapes)
            shapes[e] = shapes[e].without(part)
            trial = self._scored(fit_shapes(self.weighted, shapes, group))
            if model.better_than(trial):
                continue
            self.refused[e, part] = verdict(model, trial)
            gain = model.validations(trial)[0].gain
            if gain < worst[0]:
                worst = (gain, (e, part))
        return worst[1]

    def _add(self, name: str, model: Scored, against: Scored | None, kept: bool, reason: str) -> None:
        last = _last_kept(self.rows) if against is not None else ""
        scores = _scores(self.weighted, model, against)
        self.rows.append(ModelRow(name=name, against=last, kept=kept, reason=reason, **scores))


def _wants_bristles(problem: ExcitationProblem, model: Scored) -> bool:
    """Return whether a model has a Stribeck rise, or fits reversals of a joint worse than its other rows."""
    if any(Part.STRIBECK in shape.parts for shape in model.fit.shapes):
        return True
    squares, turns = model.residual**2, problem.reversal
    for joint in range(len(problem.arm.names)):
        own = problem.joint == joint
        at, other = squares[own & turns], squares[own & ~turns]
        if len(at) and len(other) and np.mean(at) > _REVERSAL_MISFIT**2 * np.mean(other):
            return True
    return False


def _scores(weighted: WeightedProblem, model: Scored, against: Scored | None) -> dict[str, Any]:
    """Return what a row of the table says of a model's size and errors."""
    relative, relative_all = _relative(weighted.problem, model.residual)
    by_blocks, by_runs = model.validations(against)
    return {
        "parts": tuple(tuple(p.value for p in Part if p in shape.parts) for shape in model.fit.shapes),
        "parameters": weighted.basis.shape[1] + len(model.fit.inner()),
        "error": model.error,
        "relative": relative,
        "relative_all": relative_all,
        "by_blocks": by_blocks,
        "by_runs": by_runs,
    }


def _last_kept(rows: Sequence[ModelRow]) -> str:
    return next((row.name for row in reversed(rows) if row.kept), "")


def _relative(problem: ExcitationProblem, residual: Array) -> tuple[tuple[float, ...], float]:
    """Return RMS residual over RMS torque, of each joint and of all together."""
    power = np.bincount(problem.joint, problem.torque**2, len(problem.arm.names))
    squares = np.bincount(problem.joint, residual**2, len(problem.arm.names))
    each = np.sqrt(squares / np.maximum(power, 1e-300))
    return tuple(each.tolist()), float(np.sqrt(squares.sum() / power.sum()))


def _ended(fit: SeparableFit) -> list[frozenset[str]]:
    """Return the parameters of each element that end at a bound, or leave no Coulomb torque: an exponent does so."""
    pairs = zip(fit.shapes, fit.linear[:, COULOMB].tolist(), fit.at_bound, strict=True)
    swallowed = frozenset({"alpha"})
    return [b | swallowed if Part.EXPONENT in s.parts and tau_c <= 0.0 else b for s, tau_c, b in pairs]


def _why_ended(fit: SeparableFit, e: int, name: str, element: str) -> str:
    if name in fit.at_bound[e]:
        return f"{name} of {element} ends at the bound of its range, {round(getattr(fit.shapes[e], name), 6):.3g}"
    return f"with an exponent no Coulomb torque of {element} is left"


def candidates(weighted: WeightedProblem, shape: ElementShape, element: int, part: Part) -> list[ElementShape]:
    """Return the shapes to start from with a part that an element is given."""
    if part is Part.EXPONENT:
        return [shape]
    name = "omega_s" if part is Part.STRIBECK else "stiffness"
    low, high = weighted.bounds(element, name)
    points = np.exp(np.linspace(low, high, _START_COUNT + 2)[1:-1]).tolist()
    if part is Part.STRIBECK:
        return [replace(shape, rise=_START_RISE, omega_s=value) for value in points]
    rising = [shape]
    if Part.STRIBECK in shape.parts and not shape.rise:
        rising = candidates(weighted, shape, element, Part.STRIBECK)[1::2]
    return [replace(one, stiffness=value) for value in points for one in rising]


def _started(
    weighted: WeightedProblem, now: Sequence[ElementShape], part: Part, tried: Set[Part]
) -> list[ElementShape]:
    """Return the shapes with a part, and others tried with it, on every element that moves, from the best start."""
    shapes = list(now)
    for e, shape in enumerate(shapes):
        if not len(weighted.elements[e].rows):
            continue
        # A rise that was fitted without a bristle has the bristle's torque in it.
        fresh = shape.without(Part.STRIBECK) if Part.STRIBECK in tried else shape
        begun = replace(fresh, parts=fresh.parts | tried)
        shapes[e] = best_start(weighted, shapes, e, candidates(weighted, begun, e, part))
    return shapes


def verdict(model: Scored, against: Scored) -> str:
    """Return by how much a model predicts better, in words."""
    blocks, runs = model.validations(against)
    texts = []
    for kind, one in (("blocks", blocks), ("runs", runs)):
        if one is not None:
            before = one.error + one.gain
            share, deviation = 100.0 * one.gain / before, 100.0 * one.gain_deviation / before
            way = "rises" if share < 0.0 else "falls"
            texts.append(f"by {kind} the error {way} by {abs(share):.2f} % with a standard error of {deviation:.2f} %")
    return "; ".join(texts)


def _groups(problem: ExcitationProblem) -> list[tuple[int, ...]]:
    """Return elements that act on joints together, directly or by way of others."""
    acts = problem.arm.element_matrix != 0.0
    together = acts @ acts.T
    for _ in range(len(together)):
        together = together @ together
    return sorted({tuple(np.flatnonzero(row).tolist()) for row in together})


def tangent(weighted: WeightedProblem, fit: SeparableFit, inner: Sequence[tuple[int, str]]) -> Array:
    """Return the columns of the whole model, linear around a fit, shape (r, q).

    Args:
        weighted: the rows.
        fit: around which.
        inner: elements and names of the friction's parameters, whose columns follow the regressor. Those of non-linear
            parameters belong to their changes.
    """
    columns = [weighted.column(fit.shapes, fit.linear, e, name) / weighted.weight for e, name in inner]
    return np.column_stack([weighted.problem.regressor, *columns])


def _reweighted(weighted: WeightedProblem, fit: SeparableFit) -> WeightedProblem:
    """Return the rows with the weights of a fit's residuals."""
    linear = solve(weighted.problem, tangent(weighted, fit, fit.inner()))
    weight = np.sqrt(linear.weights) / linear.sigma[weighted.problem.joint]
    return WeightedProblem.of(weighted.problem, weighted.elements, weight)
