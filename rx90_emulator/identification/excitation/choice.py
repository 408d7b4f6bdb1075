"""Select the parts of each element's friction: those with which the model predicts unseen rows better.

Starting from Coulomb and viscous friction, parts are tried in the order of their physical plausibility: viscous
exponent, Stribeck rise, bristle, bristle damping. A part is given to all elements at once, since a part missing on one
joint disturbs the joints it is coupled with; then it is removed from one element after the other that predicts as well
without it. Earlier parts of an element are tested again with each later one, which may replace them.

A Stribeck rise and a bristle both act in the rows after a reversal, and each alone takes over the other's torque:
bristle, damping and rise are tried together. Whether requested or not, bristles are tried where a rise was found, and
where rows of reversals fit worse than others: a neglected bristle biases all other parameters.

Prediction is measured on blocks of time and on whole runs that were left out. A block is long compared with the
autocorrelation of the residuals, and its neighbourhood is left out with it. The model without a block is a Gauss-Newton
step away from that of all rows, so that no fit is repeated.

A viscous exponent near the lower bound of its range makes the viscous torque nearly a Coulomb torque, so that the runs
cannot distinguish the two: such an exponent is dropped. If the user names the parts, every element has them, and a part
is dropped only if one of its parameters ends at a bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from rx90_common.base.arrays import Array, Index
from rx90_common.friction.held_out import HeldOutErrors
from rx90_emulator.identification.arm import joint_groups
from rx90_emulator.identification.excitation.fit import SeparableFit, WeightedProblem, best_start, fit_shapes, solve
from rx90_emulator.identification.excitation.law import (
    COULOMB,
    PART_OF,
    SHAPED,
    VISCOUS,
    ElementShape,
    Part,
    element_rows,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_CORRELATION_TIMES = 4.0  # in a block
# of all runs together
_MIN_BLOCKS = 8
_MAX_BLOCKS = 60
_MAX_LAG_SHARE = 0.2  # of a run
_CUTOFF = 1e-10  # relative: directions that the remaining rows do not determine keep their values

Folds = list[tuple[Index, Index]]
"""Groups of rows to predict, each with the rows that are left out for it: the group, and its neighbours."""


def left_out(residual: Array, tangent: Array, folds: Folds) -> Array:
    """Return the weighted residuals of each group of rows by the model fitted without it, shape (r,).

    The model without a group is one Gauss-Newton step away from that of all rows; for a model without non-linear
    parameters that is exact.

    Args:
        residual: of all rows, shape (r,), and
        tangent: shape (r, k), as `WeightedProblem.linearised` returns them.
        folds: the groups.
    """
    whole = tangent.T @ tangent
    gradient = tangent.T @ residual
    result = np.empty_like(residual)
    for rows, near in folds:
        gram = whole - tangent[near].T @ tangent[near]
        right = gradient - tangent[near].T @ residual[near]
        # A Cholesky factor takes a hundredth of the time of singular values, which are used where it fails.
        factor, failed = dpotrf(gram, lower=1)
        if failed or np.diag(factor).min() ** 2 < _CUTOFF:
            step = np.linalg.lstsq(gram, right, rcond=_CUTOFF)[0]
        else:
            step = dpotrs(factor, right, lower=1)[0]
        result[rows] = residual[rows] - tangent[rows] @ step
    return result


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """The rows in blocks of time of about equal length; all joints of a time, and its repetitions, are in one block.

    Attributes:
        length: of a block, s.
        correlation_time: time in which the autocorrelation of the residuals fades, s.
        reason: how the length was chosen, in words.
        block: number of each row's block, shape (r,).
        folds: each block's rows, and those with its neighbours within a correlation time on both sides.
    """

    length: float
    correlation_time: float
    reason: str
    block: Index
    folds: Folds

    @property
    def count(self) -> int:
        """Return how many blocks there are."""
        return len(self.folds)

    @classmethod
    def of(cls, problem: ExcitationProblem, residual: Array) -> TimeBlocks:
        """Choose the blocks from the residuals of a model, shape (r,).

        A block is long compared with the autocorrelation of the residuals, so that errors of blocks are independent.
        Rows within a correlation time of a block are left out with it, so that neighbours contain no information on it
        (Burman, Chow and Nolan 1994: h-block cross-validation). A repetition of a time, in another period or run, has
        the same misfit and belongs to the same block.
        """
        correlation = _correlation_time(problem, residual)
        motion = np.unique(problem.motion, return_inverse=True)[1].ravel()
        time = problem.phase * np.array([run.down / run.rate for run in problem.runs])[problem.run]
        durations = np.array([max(rows.max(), 1e-9) for rows in _grouped(time, motion)])  # 0 for a single instant
        whole = float(durations.sum())
        requested = _CORRELATION_TIMES * correlation
        length = min(max(requested, whole / _MAX_BLOCKS), whole / _MIN_BLOCKS)
        reason = f"{_CORRELATION_TIMES:g} correlation times of the residuals, {correlation:.3g} s"
        if length > requested:
            reason = f"a {_MAX_BLOCKS}th of the motions, more than {reason}"
        elif length < requested:
            reason = f"an {_MIN_BLOCKS}th of the motions, less than {reason}: the motions are short"
        counts = np.maximum(1, np.round(durations / length)).astype(np.intp)
        place = (time / durations[motion] * counts[motion]).astype(np.intp)
        first = np.cumsum(counts) - counts
        block = np.unique(first[motion] + np.minimum(place, counts[motion] - 1), return_inverse=True)[1].ravel()
        folds = []
        for rows in _grouped(np.arange(len(block)), block):
            near = (time > time[rows].min() - correlation) & (time < time[rows].max() + correlation)
            folds.append((rows, np.flatnonzero(near & (motion == motion[rows[0]]))))
        return cls(whole / float(counts.sum()), correlation, reason, block, folds)


def _grouped(values: Array | Index, number: Index) -> list[Index]:
    """Return the values of each group of rows, by the numbers of the groups, both of shape (r,)."""
    return [values[number == k] for k in range(int(number.max()) + 1)]


def _correlation_time(problem: ExcitationProblem, residual: Array) -> float:
    """Return the integrated autocorrelation time of the residuals, s, of the joint where it is longest.

    It is summed up to the first lag at which the autocorrelation is not positive.
    """
    times = [0.0]
    lags = max(int(_MAX_LAG_SHARE * len(run.rows)) for run in problem.runs)
    period = problem.runs[-1].down / problem.runs[-1].rate
    for joint in range(int(problem.joint.max()) + 1):
        products = np.zeros(lags)  # of residuals at a distance of so many samples, summed over the runs
        for number, run in enumerate(problem.runs):
            rows = (problem.run == number) & (problem.joint == joint)
            series = np.zeros(len(run.rows))
            series[problem.place[rows]] = residual[rows]
            size = 2 * len(series)
            lagged = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[: int(_MAX_LAG_SHARE * len(series))]
            products[: len(lagged)] += lagged
        if lags and products[0] > 0.0:
            fading = products / products[0]
            end = int(np.argmax(fading <= 0.0)) if (fading <= 0.0).any() else lags
            times.append(period * (2.0 * float(fading[:end].sum()) - 1.0))
    return max(times)


class CrossValidation(NamedTuple):
    """Accuracy of a model's prediction of rows that it was not fitted to.

    Attributes:
        error: weighted RMS of the residuals of the rows left out, in noise deviations of the joints.
        relative: RMS of these residuals over the RMS torque, all joints together.
        gain: reduction of `error` against the model it is compared with; 0 for the first model.
        gain_deviation: standard error of `gain`, from paired differences over the blocks.
    """

    error: float
    relative: float
    gain: float
    gain_deviation: float


@dataclass(frozen=True, eq=False)
class Scored:
    """A model with its errors on rows left out.

    Attributes:
        fit: to all rows.
        residual: of all rows, Nm, shape (r,).
        held_out: by "blocks", and by "runs" if there are several: squared weighted residuals of the rows left out,
            summed in each block, shape (b,), and their RMS over the RMS torque.
        rows: in each block, shape (b,).
    """

    fit: SeparableFit
    residual: Array
    held_out: dict[str, tuple[Array, float]]
    rows: Array

    @classmethod
    def of(cls, weighted: WeightedProblem, fit: SeparableFit, time: TimeBlocks) -> Scored:
        """Score a fit."""
        residual, tangent = weighted.linearised(fit)
        problem = weighted.problem
        folds = {"blocks": time.folds}
        if len(problem.runs) > 1:
            folds["runs"] = [(rows, rows) for rows in _grouped(np.arange(len(problem)), problem.run)]
        held_out = {}
        for kind, groups in folds.items():
            errors = left_out(residual, tangent, groups)
            relative = np.linalg.norm(errors / weighted.weight) / np.linalg.norm(problem.torque)
            held_out[kind] = (np.bincount(time.block, errors**2).astype(np.float64), float(relative))
        return cls(fit, residual / weighted.weight, held_out, np.bincount(time.block).astype(np.float64))

    def validations(self, against: Scored | None = None) -> dict[str, CrossValidation]:
        """Return the figures by "blocks", and by "runs" where both have them, with the gain over another model."""
        other = self if against is None else against
        found = {}
        for kind, (own, relative) in self.held_out.items():
            if kind in other.held_out:
                errors = HeldOutErrors({"own": own, "other": other.held_out[kind][0]}, self.rows)
                found[kind] = CrossValidation(errors.rms("own")[0], relative, *errors.gain("own", "other"))
        return found

    def better_than(self, other: Scored) -> bool:
        """Return whether this model predicts better: by blocks, and by runs where there are several.

        By blocks the gain must exceed the standard error of the paired differences. One standard error, not two: a
        neglected part biases all other parameters, a superfluous part only widens their deviations. By runs a loss, if
        there is one, must lie within that error: few runs contain less information than many blocks.
        """
        figures = self.validations(other)
        blocks = figures["blocks"]
        runs = figures.get("runs")
        return blocks.gain > blocks.gain_deviation and (runs is None or runs.gain > -runs.gain_deviation)

    def verdict(self, against: Scored) -> str:
        """Return by how much the model predicts better than another one, in words."""
        texts = []
        for kind, one in self.validations(against).items():
            share = 100.0 * one.gain / (one.error + one.gain)
            deviation = 100.0 * one.gain_deviation / (one.error + one.gain)
            way = f"{'rises' if share < 0.0 else 'falls'} by {abs(share):.2f} %"
            texts.append(f"by {kind} the error {way} with a standard error of {deviation:.2f} %")
        return "; ".join(texts)


class ModelRow(NamedTuple):
    """One row of the table of models.

    Attributes:
        name: of the model.
        parameters: how many are fitted, rigid body and friction.
        relative_all: RMS residual over RMS torque, all joints together.
        by_blocks: cross-validation by blocks of time, with the gain over the last model that was kept.
        by_runs: cross-validation by runs; None where there is one run.
        kept: whether later models are compared with this one.
        reason: why it is kept or not.
    """

    name: str
    parameters: int
    relative_all: float
    by_blocks: CrossValidation
    by_runs: CrossValidation | None
    kept: bool
    reason: str


PartKey = tuple[int, Part]
"""Number of an element, and a part of its friction."""

_COMPANIONS = {
    # If the rise is fitted first, it hides an exponent below 1.
    Part.STRIBECK: frozenset({Part.EXPONENT}),
    Part.BRISTLE: frozenset({Part.STRIBECK, Part.DAMPING}),
}
"""Parts that are tried together with another one."""
_START_COUNT = 5  # number of Stribeck velocities, and of presliding distances, to start from
_START_RISE = 0.3  # to start from
_REVERSAL_MISFIT = 1.2  # RMS residual of reversals over that of other rows, above which bristles are tried
_BOUND_SE = 2.0  # deviations of an exponent from its lower bound, below which the runs do not determine it


def select_parts(
    problem: ExcitationProblem,
    parts: Sequence[Part],
    progress: Callable[[str], None] = lambda _: None,
    *,
    fixed: bool = False,
) -> Selection:
    """Try parts in the given order and keep those with which the model predicts better; or give them to all elements.

    `progress` is called with the name of each part before its trial. With `fixed`, no part is tried beside the given
    ones, and none is dropped because the model predicts as well without it.
    """
    search = Selection(problem, parts, fixed=fixed)
    attempts = [part for part in parts if part is not Part.DAMPING]
    if Part.STRIBECK in parts and Part.BRISTLE not in parts and not fixed:
        attempts.append(Part.BRISTLE)  # only after a rise, or where reversals fit badly
    for part in attempts:
        if part in parts or _wants_bristles(problem, search.now):
            progress(f"trial of the {part.value}")
            search.attempt(part)
    return search


class Selection:
    """The model so far, and the table of the compared models.

    Attributes:
        weighted: the rows with their last weights.
        now: the model.
        blocks: of the cross-validation.
        rows: of the table of models.
        refused: why an element does not have a part that was tried on it.
    """

    def __init__(self, problem: ExcitationProblem, parts: Sequence[Part], *, fixed: bool = False) -> None:
        self._problem = problem
        self._fixed = fixed
        more = Part.STRIBECK in parts and not fixed
        self._allowed = frozenset({*parts, Part.BRISTLE, Part.DAMPING} if more else parts)
        self._groups = [group.elements for group in joint_groups(problem.arm)]
        self.rows: list[ModelRow] = []
        self.refused: dict[PartKey, str] = {}
        elements = element_rows(problem)
        shapes = [ElementShape() for _ in elements]
        unweighted = WeightedProblem.of(problem, elements, np.ones(len(problem)))
        self.weighted = _reweighted(unweighted, fit_shapes(unweighted, shapes))
        fit = fit_shapes(self.weighted, shapes)
        self.blocks = TimeBlocks.of(problem, self.weighted.linearised(fit)[0])
        self.now = self._scored(fit)
        self._add("Coulomb + viscous", self.now, None, kept=True, reason="what the others are compared with")

    @property
    def fit(self) -> SeparableFit:
        """Return the fit of the model."""
        return self.now.fit

    def attempt(self, part: Part) -> None:
        """Give a part to all elements, remove it where it is not needed, and keep it if the model predicts better."""
        shapes = self._started(part)
        given = [e for e, shape in enumerate(shapes) if part in shape.parts]
        keys = [(e, old) for e in given for old in shapes[e].parts if old is not Part.BRISTLE or old is part]
        if not keys:
            return
        # Weights of the larger model: the smaller model's would reduce the weight of the rows in which the part acts.
        fit = fit_shapes(self.weighted, shapes)
        self.weighted = _reweighted(self.weighted, fit)
        before = self._scored(fit_shapes(self.weighted, self.now.fit.shapes))
        everywhere = self._scored(fit_shapes(self.weighted, fit.shapes))
        trimmed = self.within_bounds(everywhere, part)
        if not self._fixed:
            # Without the removed parts, others may come to a bound.
            trimmed = self.within_bounds(self._trimmed(trimmed, keys), part)
        remaining = [e for e, shape in enumerate(trimmed.fit.shapes) if part in shape.parts]
        kept = bool(remaining) and (self._fixed or trimmed.better_than(before))
        if trimmed.fit.shapes != everywhere.fit.shapes:
            none = "it ends at a bound on all elements" if self._fixed else "no element predicts better with it"
            reason = "kept on some elements, see below" if kept else none
            self._add(f"+ {part.value}: all", everywhere, before, kept=False, reason=reason)
        if remaining:
            text = "asked for; " * self._fixed + trimmed.verdict(before)
            names = self._problem.arm.element_names
            where = "all" if len(remaining) == len(given) else ", ".join(names[e] for e in remaining)
            self._add(f"+ {part.value}: {where}", trimmed, before, kept=kept, reason=text)
            self.refused |= {} if kept else {(e, part): text for e in remaining}
        if kept:
            self.now = trimmed
        self.weighted = _reweighted(self.weighted, self.now.fit)
        self.now = self.within_bounds(self._scored(fit_shapes(self.weighted, self.now.fit.shapes)))

    def _scored(self, fit: SeparableFit) -> Scored:
        return Scored.of(self.weighted, fit, self.blocks)

    def _started(self, part: Part) -> list[ElementShape]:
        """Return the shapes with a part, and its companions, on every moving element, from the best start values."""
        tried = {part, *(_COMPANIONS.get(part, frozenset()) & self._allowed)}
        shapes = list(self.now.fit.shapes)
        for e, shape in enumerate(shapes):
            if len(self.weighted.elements[e].rows):
                # A rise that was fitted without a bristle contains the bristle's torque.
                fresh = shape.without(Part.STRIBECK) if Part.STRIBECK in tried else shape
                extended = replace(fresh, parts=fresh.parts | tried)
                shapes[e] = best_start(self.weighted, shapes, e, candidates(self.weighted, extended, e, part))
        return shapes

    def within_bounds(self, model: Scored, part: Part | None = None) -> Scored:
        """Return a model in which no parameter lies at a bound of its range, where it has no meaning.

        A Stribeck rise is tried again with delta = 1, the exponent in the literature; then `part`, the one on trial, is
        dropped, and otherwise the part that the parameter belongs to.
        """
        while any(ended := _ended(model.fit)) or any(ended := self._indeterminate_exponents(model.fit)):
            shapes = list(model.fit.shapes)
            for e, bound in enumerate(ended):
                if bound:
                    shapes[e] = self._inside(model.fit, e, sorted(bound), part)
            model = self._scored(fit_shapes(self.weighted, shapes))
        return model

    def _inside(self, fit: SeparableFit, e: int, bound: Sequence[str], part: Part | None) -> ElementShape:
        """Return another shape for an element whose parameters `bound` lie at a bound."""
        shape = fit.shapes[e]
        before = self.now.fit.shapes[e]
        if Part.STRIBECK in shape.parts and "delta" not in shape.fixed:
            exponent_one = replace(shape, delta=1.0, fixed=shape.fixed | {"delta"}, alpha=before.alpha)
            return best_start(self.weighted, fit.shapes, e, candidates(self.weighted, exponent_one, e, Part.STRIBECK))
        tried = part if part in shape.parts else None
        own = [name for name in bound if tried is None or name in tried.shape]
        name = (own or bound)[0]
        whose = PART_OF[name]
        is_companion = (
            part is not None
            and whose in _COMPANIONS.get(part, ())
            and (part is Part.BRISTLE or whose not in before.parts)
        )
        dropped = whose if is_companion else tried or whose
        element = self._problem.arm.element_names[e]
        at = f"{round(getattr(shape, name), 6):.3g}"
        if name in fit.at_bound[e]:
            why = f"{name} of {element} ends at the bound of its range, {at}"
        elif fit.linear[e, COULOMB] <= 0.0:
            why = f"beside it no Coulomb torque of {element} shows"
        elif fit.linear[e, VISCOUS] <= 0.0:
            why = f"{element} has no viscous torque that an exponent could shape"
        else:
            why = (
                f"alpha of {element}, {at}, is within {_BOUND_SE:g} deviations of the bound of its range: the runs do "
                "not distinguish such a viscous torque from Coulomb torque"
            )
        self.refused[e, dropped] = why
        return shape.without(dropped) if own or is_companion else before

    def _indeterminate_exponents(self, fit: SeparableFit) -> list[frozenset[str]]:
        """Return "alpha" for each element whose exponent is too near its bound to differ from Coulomb torque."""
        inner = fit.inner()
        found = [frozenset[str]()] * len(fit.shapes)
        places = [(k, e) for k, (e, name) in enumerate(inner) if name == "alpha"]
        # An exponent that the user requested is kept: its deviation shows how well it is determined.
        if places and not self._fixed:
            linear = solve(self._problem, self.weighted.tangent(fit, inner))
            for k, e in places:
                deviation = float(linear.deviation[len(self._problem.names) + k])
                if fit.shapes[e].alpha - _BOUND_SE * deviation < self.weighted.bounds(e, "alpha")[0]:
                    found[e] = frozenset({"alpha"})
        return found

    def _trimmed(self, model: Scored, keys: Sequence[PartKey]) -> Scored:
        """Remove parts, the most useless first, until the model predicts better with each remaining one.

        Groups of elements that share no joint are processed side by side.
        """
        todo = {group: [key for key in keys if key[0] in group] for group in self._groups}
        while any(todo.values()):
            shapes = list(model.fit.shapes)
            for group, some in todo.items():
                there = [(e, part) for e, part in some if part in model.fit.shapes[e].parts]
                useless = self._most_useless(model, there, group)
                todo[group] = [] if useless is None else [key for key in there if key != useless]
                if useless is not None:
                    shapes[useless[0]] = shapes[useless[0]].without(useless[1])
            if shapes != list(model.fit.shapes):
                model = self._scored(fit_shapes(self.weighted, shapes))
        return model

    def _most_useless(self, model: Scored, keys: Iterable[PartKey], group: Sequence[int]) -> PartKey | None:
        """Return the part without which the model predicts as well or better, by the most; None if there is none.

        The non-linear parameters of elements that share no joint with the group are not fitted again: they hardly
        change.
        """
        gains: dict[PartKey, float] = {}
        for e, part in keys:
            shapes = list(model.fit.shapes)
            shapes[e] = shapes[e].without(part)
            trial = self._scored(fit_shapes(self.weighted, shapes, group))
            if not model.better_than(trial):
                self.refused[e, part] = model.verdict(trial)
                gains[e, part] = model.validations(trial)["blocks"].gain
        return min(gains, key=lambda key: gains[key], default=None)

    def _add(self, name: str, model: Scored, against: Scored | None, *, kept: bool, reason: str) -> None:
        relative = float(np.linalg.norm(model.residual) / np.linalg.norm(self._problem.torque))
        count = self.weighted.basis.shape[1] + len(model.fit.inner())
        figures = model.validations(against)
        self.rows.append(ModelRow(name, count, relative, figures["blocks"], figures.get("runs"), kept, reason))


def _wants_bristles(problem: ExcitationProblem, model: Scored) -> bool:
    """Return whether a model has a Stribeck rise, or fits reversals of a joint worse than its other rows."""
    if any(Part.STRIBECK in shape.parts for shape in model.fit.shapes):
        return True
    squares = model.residual**2
    turns = problem.reversal
    for joint in range(len(problem.arm.names)):
        own = problem.joint == joint
        at = squares[own & turns]
        other = squares[own & ~turns]
        if len(at) and len(other) and np.mean(at) > _REVERSAL_MISFIT**2 * np.mean(other):
            return True
    return False


def _ended(fit: SeparableFit) -> list[frozenset[str]]:
    """Return each element's parameters at a bound, and those that shape no torque or leave no Coulomb torque.

    An exponent leaves no Coulomb torque if the viscous torque is all of the friction.
    """
    found = []
    for shape, linear, bound in zip(fit.shapes, fit.linear.tolist(), fit.at_bound, strict=True):
        without = {name for name, place in SHAPED.items() if linear[place] <= 0.0 or linear[COULOMB] <= 0.0}
        found.append(bound | (without & set(shape.free)))
    return found


def candidates(weighted: WeightedProblem, shape: ElementShape, element: int, part: Part) -> list[ElementShape]:
    """Return the start shapes for an element with a new part."""
    if part is Part.EXPONENT:
        return [shape]
    low, high = weighted.bounds(element, "omega_s" if part is Part.STRIBECK else "stiffness")
    points = np.exp(np.linspace(low, high, _START_COUNT + 2)[1:-1]).tolist()
    if part is Part.STRIBECK:
        return [replace(shape, rise=_START_RISE, omega_s=value) for value in points]
    rising = [shape]
    if Part.STRIBECK in shape.parts and not shape.rise:
        rising = candidates(weighted, shape, element, Part.STRIBECK)[1::2]
    return [replace(one, stiffness=value) for value in points for one in rising]


def _reweighted(weighted: WeightedProblem, fit: SeparableFit) -> WeightedProblem:
    """Return the rows with the weights of a fit's residuals."""
    linear = solve(weighted.problem, weighted.tangent(fit, fit.inner()))
    weight = np.sqrt(linear.weights) / linear.sigma[weighted.problem.joint]
    return WeightedProblem.of(weighted.problem, weighted.elements, weight)
