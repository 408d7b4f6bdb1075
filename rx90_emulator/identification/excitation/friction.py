"""What the friction model leaves out, and what the deviations of its parameters owe to that.

**Rises and bristle damping** that the runs neither show nor exclude. A rise near the least speeds bends the curve the
other way than an exponent below 1, and lifts what looks like Coulomb friction. Where cross-validation did not keep one,
a rise of some size may still be there: covariances are then those of the model in which it lies anywhere from 0 on.
Static torque below Coulomb torque is no friction, and more than twice the Coulomb torque is assumed not to occur; fits
know nothing of either and may say -125 % with a deviation of 197 %. A bristle without its damping c1 takes the torque
of the damping for its own, which is in the same rows: it comes out stiffer by 5 to 10 %. Each bristle whose damping was
not kept may have one of any size from 0 on. So may viscous friction whose best value is its bound 0.

**Torques at their bound 0.** No friction drives: tau_c and c2 are at least 0. What a fit without that bound would give
says why nothing is left of them: friction that falls with speed, a torque that does not oppose the motion, or noise.
**Load.** Gears press harder on their bearings and teeth the more torque they carry. A model without that gives Coulomb
torques at the usual load of the runs; how far they are from those without load belongs into their deviations. One
coefficient for all elements, relative to their Coulomb torques, is tested: the runs tell it far better than one each.

**Sharpness of the recorded motion.** Presliding is over within milliseconds of a reversal, and a Stribeck rise within
some hundredths of rad/s. The filter of the positions and the sampling blur the motion there, alike at each reversal: no
residual tells of it. What the values shift when the motion is known less sharply still (at half the bandwidth, over
five samples, with every second sample) is of the size of what the first blur has shifted.

The friction of all elements from excitation runs: chosen parts, values with deviations, and what is not known.

The selected model is fitted once more, linear around its shapes, with deviations that contain what it leaves out; its
values become the parameters of FrictionElement, or the reason why one is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import truncnorm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.choice import (
    ModelRow,
    PartKey,
    Selection,
    TimeBlocks,
    candidates,
    select_parts,
)
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.fit import Key, LinearFit, SeparableFit, WeightedProblem, best_start, solve
from rx90_emulator.identification.excitation.law import (
    COULOMB,
    FITTED,
    LINEAR,
    SHAPED,
    VISCOUS,
    ElementShape,
    Part,
    Speeds,
    coulomb,
    joint_columns,
    viscous,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Prior
from rx90_emulator.identification.records import BagSource

_RELEVANT_SIZE = {Part.STRIBECK: 0.2, Part.DAMPING: 0.0, "c2": 0.0}  # of tau_c, Nm s/rad: what matters
_UPPER_SE = 2.0  # deviations
_MAX_SIZE = {Part.STRIBECK: 1.0, Part.DAMPING: math.inf, "c2": math.inf}  # of tau_c, Nm s/rad: none is larger (assumed)


def undecided_parts(
    selected: Selection, columns: Array, prior: Prior | None = None
) -> tuple[dict[int, tuple[float, float]], Array | None]:
    """Return rises, bristle damping and viscous friction that may be there, though they were not kept or are 0.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        prior: of the first parameters.

    Returns:
        Value and standard deviation of rises over tau_c, as fitted without bounds, by element; and the covariance of
        the q parameters with all of these within their bounds, shape (q, q), if there are any.
    """
    table: dict[PartKey | tuple[int, str], Array] = {}
    for e, part in sorted(selected.refused, key=lambda key: (key[1].value, key[0])):
        there = selected.fit.shapes[e].parts
        beside = part is Part.STRIBECK or (part is Part.DAMPING and Part.BRISTLE in there)
        if beside and part not in there and selected.fit.linear[e, COULOMB] > 0.0:
            table[e, part] = _column(selected, e, part)
    for e, (tau_c, c2, _) in enumerate(selected.fit.linear.tolist()):
        if c2 <= 0.0 < tau_c:
            table[e, "c2"] = _linear_column(selected, (e, "c2"))
    while table:
        wide, q = (
            solve(selected.weighted.problem, np.column_stack([columns, *table.values()]), prior=prior),
            columns.shape[1],
        )
        sizes = list(zip(wide.value[q:].tolist(), wide.deviation[q:].tolist(), strict=True))
        kept = {key: column for (key, column), (value, deviation) in zip(table.items(), sizes, strict=True)
                if value + _UPPER_SE * deviation > _RELEVANT_SIZE[key[1]] and math.isfinite(deviation)}  # fmt: skip
        if len(kept) == len(table):
            bounded = bounded_covariance(wide.covariance, sizes, [_MAX_SIZE[part] for _, part in table])
            found = zip(table, sizes, strict=True)
            return {e: size for (e, part), size in found if part is Part.STRIBECK}, bounded
        table = kept
    return {}, None


def bounded_covariance(covariance: Array, sizes: Sequence[tuple[float, float]], largest: Sequence[float]) -> Array:
    """Return the covariance of all but the last parameters, where these lie between 0 and `largest`.

    The values hold for sizes of 0: what one shifts is its slope times its root mean square, that of its normal
    distribution within the bounds. Correlations between sizes stay.

    Args:
        covariance: of q + k parameters.
        sizes: values and standard deviations of the last k.
        largest: upper bounds of these.
    """
    count = len(covariance) - len(sizes)
    between = covariance[count:, count:]
    if not np.isfinite(between).all():
        return np.asarray(covariance[:count, :count])
    slope = covariance[:count, count:] @ np.linalg.pinv(between)
    factor = np.array([
        np.sqrt(truncnorm(-value / deviation, (most - value) / deviation, value, deviation).moment(2)) / deviation
        for (value, deviation), most in zip(sizes, largest, strict=True)
    ])  # fmt: skip
    change = between * np.outer(factor, factor) - between
    return np.asarray(covariance[:count, :count] + slope @ change @ slope.T)


def _column(selected: Selection, element: int, part: Part) -> Array:
    """Return the torque per unit of an element's part, a rise with the Stribeck velocity that suits it, shape (r,)."""
    weighted, shapes = selected.weighted, list(selected.fit.shapes)
    begun = replace(shapes[element], parts=shapes[element].parts | {part})
    if part is Part.STRIBECK:
        begun = replace(begun, fixed=begun.fixed | {"omega_s", "delta"})
        begun = best_start(weighted, shapes, element, candidates(weighted, begun, element, part))
    shapes[element] = begun
    key = (element, "rise" if part is Part.STRIBECK else "c1")
    return weighted.column(shapes, selected.fit.linear, key) / weighted.weight


def _linear_column(selected: Selection, key: Key) -> Array:
    """Return the torque per unit of an element's linear parameter, shape (r,)."""
    weighted = selected.weighted
    return weighted.column(selected.fit.shapes, selected.fit.linear, key) / weighted.weight


class Unbounded(NamedTuple):
    """What a fit says of parameters that are 0, their bound, when they may be less.

    Attributes:
        sizes: value and standard deviation of each that the runs determine.
        shift: what the parameters of the model shift where friction falls with speed, shape (q,).
        remarks: on which elements it does, and what that does to their tau_c.
    """

    sizes: dict[Key, tuple[float, float]]
    shift: Array
    remarks: tuple[str, ...]


def without_bounds(selected: Selection, columns: Array, without: LinearFit, prior: Prior | None = None) -> Unbounded:
    """Fit once more with tau_c and c2 free where they came out as 0.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.
    """
    problem, fit, q = selected.weighted.problem, selected.fit, columns.shape[1]
    bound = [
        (e, LINEAR[place])
        for e, rows in enumerate(selected.weighted.elements)
        for place in (COULOMB, VISCOUS)
        if len(rows.rows) and fit.linear[e, place] <= 0.0
    ]
    shift, sizes, remarks = np.zeros(q), {}, []
    if bound:
        added = [_linear_column(selected, key) for key in bound]
        wide = solve(problem, np.column_stack([columns, *added]), prior=prior)
        pairs = zip(bound, wide.value[q:].tolist(), wide.deviation[q:].tolist(), wide.determined[q:], strict=True)
        sizes = {key: (value, deviation) for key, value, deviation, known in pairs if known}
        falling = [e for e, name in sizes if name == "c2" and (e, "tau_c") not in sizes and _negative(*sizes[e, name])]
        if falling:
            one = solve(
                problem,
                np.column_stack([columns, *(_linear_column(selected, (e, "c2")) for e in falling)]),
                prior=prior,
            )
            shift = np.where(one.determined[:q] & without.determined, one.value[:q] - without.value, 0.0)
            first, inner = len(problem.names), fit.inner()
            for k, e in enumerate(falling):
                place, name = first + inner.index((e, "tau_c")), problem.arm.element_names[e]
                low, high = selected.weighted.elements[e].speed_range
                remarks.append(
                    f"the friction of {name} falls with speed, and c2 is at its bound 0: without it c2 would be "
                    f"{one.value[q + k]:.3g} +- {one.deviation[q + k]:.2g} Nm s/rad and tau_c {one.value[place]:.3g} "
                    f"in place of {without.value[place]:.3g} Nm. tau_c is a mean over the speeds from {low:.2g} to "
                    f"{high:.2g} rad/s, too small at slow ones and too large at fast ones; its deviation contains the "
                    "difference"
                )
    return Unbounded(sizes, shift, tuple(remarks))


def _negative(value: float, deviation: float) -> bool:
    """Return whether a value is below 0 by more than chance."""
    return value < -_UPPER_SE * deviation


_MIN_LOAD = 1e-6  # Nm, of a load that elements' friction is compared with
_LOAD_SE = 2.0  # deviations of the coefficient from 0


def load_dependence(
    selected: Selection, columns: Array, without: LinearFit, prior: Prior | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Test whether friction grows with the load.

    Args:
        selected: the model.
        columns: of the whole of it, linear around its fit, shape (r, q).
        without: fit of these columns.
        prior: of the first parameters, in that fit.

    Returns:
        What the parameters shift when it is admitted, shape (q,), 0 where the runs do not show it; and a remark where
        they do.
    """
    problem, fit = selected.weighted.problem, selected.fit
    bare = np.abs(problem.regressor @ without.value[: len(problem.names)])
    coulomb = joint_columns(problem, fit.shapes)[:, :, COULOMB] * fit.linear[:, COULOMB]
    column = np.zeros(len(bare))
    for e in range(len(fit.shapes)):
        own = problem.joint == np.flatnonzero(problem.arm.element_matrix[e])[-1]
        if own.any():
            # A coupled element carries the torque of the last joint that it acts on, on the rows of all of them.
            load = np.full(problem.sample.max() + 1, float(np.mean(bare[own])))
            load[problem.sample[own]] = bare[own]
            column += coulomb[:, e] * load[problem.sample] / max(float(np.sqrt(np.mean(bare[own] ** 2))), _MIN_LOAD)
    wide = solve(problem, np.column_stack([columns, column]), prior=prior)
    value, deviation = float(wide.value[-1]), float(wide.deviation[-1])
    shift = wide.value[:-1] - without.value
    if abs(value) <= _LOAD_SE * deviation:
        return np.zeros_like(shift), ()
    size = f"{100.0 * value:.2g} % with a standard deviation of {100.0 * deviation:.2g} %"
    return shift, (
        f"Coulomb friction changes with the load, at a joint's RMS torque by {size}: tau_c holds at the usual load of "
        "the runs, and its deviation contains the difference to no load",
    )


_BLURRED_BANDWIDTH_SHARE = 0.5  # bandwidth over that of the positions
_AVERAGED_SAMPLES = 5


def blur_shifts(weighted: WeightedProblem, fit: SeparableFit, columns: Array) -> list[Array]:
    """Return what all parameters shift with a motion that is known less sharply, arrays of shape (q,).

    Friction without rise and bristle knows of a reversal's time alone, which no blur moves: then there is none.

    Args:
        weighted: the rows.
        fit: of the friction.
        columns: of the whole model around it, shape (r, q).
    """
    if not any({Part.STRIBECK, Part.BRISTLE} & shape.parts for shape in fit.shapes):
        return []
    problem = weighted.problem
    sharp = joint_columns(problem, fit.shapes)
    size = np.linalg.norm(columns * weighted.weight[:, None], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    tangent = columns * weighted.weight[:, None] / scale
    shifts = []
    blurs: list[Callable[[Array, FilteredRun], Array]] = [
        lambda values, run: run.smooth(values, _BLURRED_BANDWIDTH_SHARE * run.bandwidths.position),
        lambda values, _: np.asarray(uniform_filter1d(values, _AVERAGED_SAMPLES, axis=0)),
        _every_second,
    ]
    for blur in blurs:
        other = replace(problem, runs=tuple(_blurred(run, blur) for run in problem.runs))
        lost = np.tensordot(sharp - joint_columns(other, fit.shapes), fit.linear, 2)
        shifts.append(np.asarray(np.linalg.lstsq(tangent, lost * weighted.weight, rcond=1e-8)[0] / scale))
    return shifts


def _blurred(run: FilteredRun, blur: Callable[[Array, FilteredRun], Array]) -> FilteredRun:
    """Return a run with other positions and velocities; stamps of the torque are as far apart as samples."""
    stamps = None if run.stamps is None else run.stamps._replace(velocity=blur(run.stamps.velocity, run))
    return replace(run, position=blur(run.position, run), velocity=blur(run.velocity, run), stamps=stamps)


def _every_second(values: Array, _: FilteredRun) -> Array:
    """Return values whose every second one is the mean of its neighbours, shape (m, n)."""
    result = values.copy()
    between = result[1:-1:2]
    between[:] = 0.5 * (result[:-2:2] + result[2::2])
    return result


NORMAL_95 = 1.96
_CURVE_POINTS = 60  # of each direction
WITHOUT_BRISTLES = (Part.EXPONENT, Part.STRIBECK)
ALL_PARTS = tuple(Part)
Refusal = Callable[[Part], str]
"""Says why an element does not have a part."""


class FrictionCurve(NamedTuple):
    """Steady friction torque of an element against its velocity, over velocities at which there were data.

    Attributes:
        element: its name.
        velocity: rad/s, shape (k,), increasing, both signs.
        torque: Nm, shape (k,).
        deviation: standard deviation of the torque, Nm, shape (k,).
    """

    element: str
    velocity: Array
    torque: Array
    deviation: Array

    @property
    def band(self) -> tuple[Array, Array]:
        """Return lower and upper bound of the torque at 95 %, Nm, each shape (k,)."""
        return self.torque - NORMAL_95 * self.deviation, self.torque + NORMAL_95 * self.deviation


@dataclass(frozen=True, eq=False)
class FittedElement:
    """The friction of one element as it was fitted.

    Attributes:
        element: its name.
        shape: the parameters that are not linear, and the parts it has.
        linear: tau_c, c2 and c1, in Nm, Nm (s/rad)^alpha, Nm s/rad; 0 for what it does not have, shape (3,).
        covariance: of the parameters in FITTED, shape (8, 8); 0 for what is not fitted. The exponent of a viscous
            part is free in it where the runs were asked for exponents, also if it is left at 1: what is not known of
            it is not known of tau_c and c2 either.
        ranges: least and greatest speed of its data in each direction, positive and negative: ((low, high),
            (low, high)), rad/s; (0, 0) for a direction in which it did not move.
    """

    element: str
    shape: ElementShape
    linear: Array
    covariance: Array
    ranges: tuple[tuple[float, float], tuple[float, float]]

    def curve(self, velocity: Array | None = None) -> FrictionCurve:
        """Return the steady friction torque with its deviation.

        Args:
            velocity: rad/s, shape (k,); by default over all velocities at which there were data.

        Raises:
            IdentificationError: for a velocity at which there were no data.
        """
        (low, high), (low_back, high_back) = self.ranges
        if velocity is None:
            back, forward = (
                np.geomspace(*pair, _CURVE_POINTS) if pair[1] > 0.0 else np.empty(0) for pair in self.ranges[::-1]
            )
            velocity = np.concatenate([-back[::-1], forward])
        inside = ((velocity >= low) & (velocity <= high)) | ((-velocity >= low_back) & (-velocity <= high_back))
        if not inside.all():
            found = f"{self.element}: velocity {velocity[~inside][0]:.4g} rad/s"
            accepted = f"{-high_back:.4g} to {-low_back:.4g} and {low:.4g} to {high:.4g} rad/s, where there were data"
            raise IdentificationError(f"{found}; accepted: {accepted}")
        columns, slopes = steady_columns(self.shape, velocity)
        by_shape = [
            slopes[name] * self.linear[place] if name in slopes else 0.0 * velocity for name, place in SHAPED.items()
        ]
        matrix = np.column_stack([columns, *by_shape])
        variance = np.einsum("ki,ij,kj->k", matrix, self.covariance, matrix)
        return FrictionCurve(self.element, velocity, columns @ self.linear, np.sqrt(np.maximum(variance, 0.0)))


def steady_columns(shape: ElementShape, velocity: Array) -> tuple[Array, dict[str, Array]]:
    """Return what the linear parameters multiply in steady sliding, shape (m, 3), and derivatives of it.

    Args:
        shape: of the element.
        velocity: rad/s, shape (m,).

    Returns:
        Columns of LINEAR, and derivatives by the other parameters of the one that each shapes, as SHAPED has it.
    """
    speeds = Speeds.of(velocity)
    (dry, slopes), (wet, by_alpha) = coulomb(shape, speeds), viscous(shape, speeds)
    return np.column_stack([dry, wet, np.zeros_like(velocity)]), {"alpha": by_alpha, **slopes}


@dataclass(frozen=True, eq=False)
class FrictionSelection:
    """The friction of all elements with the parts that predict better, and the models that were compared.

    Attributes:
        models: rows of the table, in the order in which they were compared.
        blocks: of the cross-validation.
        fitted: elements as they were fitted, in the arm's order.
        elements: their estimates by the names of FrictionElement, with the reason for each that is not identifiable.
        fit: of the kept model, linear around the non-linear parameters (whose values there are their last changes):
            the problem's parameters, then the friction's, with HAC covariance. Its last values may be exponents that
            are left at 1, and whose uncertainty the covariance knows.
        names: of the values of `fit`; a friction parameter is `element.parameter`.
        predicted: torque of every row by the kept model, Nm, shape (r,).
        remarks: what a reader of the figures must know.
        warnings: on elements whose friction is not what the model says.
    """

    models: tuple[ModelRow, ...]
    blocks: TimeBlocks
    fitted: tuple[FittedElement, ...]
    elements: tuple[ElementEstimate, ...]
    fit: LinearFit
    names: tuple[str, ...]
    predicted: Array
    remarks: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[frozenset[Part], ...]:
        """Return the parts that each element has."""
        return tuple(one.shape.parts for one in self.fitted)

    def curves(self) -> tuple[FrictionCurve, ...]:
        """Return the curves of all elements, over the velocities at which there were data."""
        return tuple(one.curve() for one in self.fitted)


def identify_friction_parts(
    problem: ExcitationProblem,
    parts: Sequence[Part] = WITHOUT_BRISTLES,
    prior: Prior | None = None,
    progress: Callable[[str], None] = lambda _: None,
    *,
    fixed: bool = False,
) -> FrictionSelection:
    """Identify rigid body and friction together, and choose the friction's parts by cross-validation.

    Args:
        problem: the rows.
        parts: to try beside Coulomb and viscous friction, in this order; bristles take several times as long.
        prior: of the base parameters, for the values; the parts are chosen by the runs alone.
        progress: called with the name of each stage of the choice before it, `choice.stages(parts, fixed)` times.
        fixed: whether all elements have the parts, without a choice.

    Returns:
        The selection. Parameters that the runs do not tell are unknown, with a reason.
    """
    selected = select_parts(problem, parts, progress, fixed=fixed)
    inner, final, rises, free, remarks = final_fit(selected, parts, prior)
    names, shapes, linear = problem.arm.element_names, list(selected.fit.shapes), selected.fit.linear.copy()
    moved = [shape.values for shape in shapes]
    for (e, name), value in zip(inner, final.value[len(problem.names) :].tolist(), strict=True):
        if name in LINEAR:
            linear[e, LINEAR.index(name)] = value
        elif name in shapes[e].free:
            moved[e][shapes[e].free.index(name)] += value
    fitted = tuple(
        FittedElement(name, shape.with_values(values), own, _block(e, inner, final.covariance), rows.speeds)
        for e, (name, shape, values, own, rows) in enumerate(
            zip(names, shapes, moved, linear, selected.weighted.elements, strict=True)
        )
    )
    sources = tuple(run.source for run in problem.runs)
    refusals = [_refusal(selected, e, parts, rises.get(e)) for e in range(len(fitted))]
    reasons = [_torque_reasons(selected, e, free) for e in range(len(fitted))]
    return FrictionSelection(
        models=tuple(selected.rows),
        blocks=selected.blocks,
        fitted=fitted,
        elements=tuple(element_estimate(*three, sources) for three in zip(fitted, refusals, reasons, strict=True)),
        fit=final,
        names=(*problem.names, *(f"{names[e]}.{name}" for e, name in inner)),
        predicted=problem.torque - final.residual,
        remarks=(*_constant_remarks(problem, selected, final), *remarks),
        warnings=free.remarks,
    )


def predicted_torque(selection: FrictionSelection, problem: ExcitationProblem) -> Array:
    """Return the torque of the rows of other runs of the same arm by the selected model, Nm, shape (r,)."""
    columns = joint_columns(problem, [one.shape for one in selection.fitted])
    linear = np.array([one.linear for one in selection.fitted])
    rigid = problem.regressor @ selection.fit.value[: len(problem.names)]
    return np.asarray(rigid + np.tensordot(columns, linear, 2))


def linear_columns(selection: FrictionSelection, problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns of the linear friction parameters that a selection has, by its shapes, shape (r, f).

    Args:
        selection: the shapes.
        problem: of the same arm, along whose motion the columns are.
    """
    names = [f"{one.element}.{name}" for one in selection.fitted for name in LINEAR]
    there = [k for k, name in enumerate(names) if name in selection.names]
    columns = joint_columns(problem, [one.shape for one in selection.fitted]).reshape(len(problem), -1)
    return tuple(names[k] for k in there), columns[:, there]


def with_linear(
    selection: FrictionSelection, problem: ExcitationProblem, names: Sequence[str], fit: LinearFit
) -> FrictionSelection:
    """Return a selection with the linear parameters of another fit, the shapes as they are.

    Args:
        selection: as it was.
        problem: the rows of both.
        names: of the values of the other fit: all linear ones of the selection.
        fit: for the selection's shapes. What is not known of these is added to its covariance.
    """
    covariance, places = selection.fit.covariance.copy(), np.array([selection.names.index(name) for name in names])
    shapes = np.setdiff1d(np.arange(len(covariance)), places)
    between = covariance[np.ix_(shapes, shapes)]
    slope = covariance[np.ix_(places, shapes)] @ np.linalg.pinv(between)
    covariance[np.ix_(places, places)] = fit.covariance + slope @ between @ slope.T
    value = np.zeros(len(selection.names))
    value[places] = fit.value
    pairs = [name.rpartition(".") for name in selection.names[len(problem.names) :]]
    inner = [(problem.arm.element_names.index(element), name) for element, _, name in pairs]
    linear = np.zeros((len(selection.fitted), len(LINEAR)))
    for (e, name), own in zip(inner, value[len(problem.names) :].tolist(), strict=True):
        if name in LINEAR:
            linear[e, LINEAR.index(name)] = own
    fitted, elements = [], []
    for e, (one, old) in enumerate(zip(selection.fitted, selection.elements, strict=True)):
        fitted.append(replace(one, linear=linear[e], covariance=_block(e, inner, covariance)))
        reasons = {part: old.parameters[name].reason for name, part in _PART_OF.items()}
        torques = {name: old.parameters[f"{name}_positive" if name == "tau_c" else name].reason for name in LINEAR[:2]}
        elements.append(element_estimate(fitted[-1], reasons.__getitem__, torques, old.sources))
    other = replace(selection, fitted=tuple(fitted), elements=tuple(elements), fit=replace(fit, value=value))
    predicted = predicted_torque(other, problem)
    whole = replace(other.fit, covariance=covariance, residual=problem.torque - predicted)
    return replace(other, fit=whole, predicted=predicted)


_MAX_EXPONENT_STEP = 0.8  # of an exponent from 1
_CONSTANT_RESIDUAL = 1e-6  # share of a constant torque that the regressor may leave, to explain it


def final_fit(
    selected: Selection, parts: Sequence[Part], prior: Prior | None = None
) -> tuple[tuple[Key, ...], LinearFit, dict[int, tuple[float, float]], Unbounded, tuple[str, ...]]:
    """Return the friction's parameters and the fit of the whole model, linear around the one selected.

    Exponents that were tried and not kept stay at 1, but the covariance is that with them free: the runs say no more of
    tau_c and c2 because an exponent was left out; the same holds for a Stribeck rise, or the damping of a bristle, that
    may be there. What the values shift with these exponents, with a growth of friction with the load, and with a motion
    that is known less sharply, widens the covariance, too.

    Returns:
        The parameters, whose values follow those of the base in the fit; the fit; value and standard deviation over
        tau_c of Stribeck rises that may be there, by element; what torques at their bound 0 would be; remarks.
    """
    weighted, fit = selected.weighted, selected.fit
    problem, inner = weighted.problem, fit.inner()
    opened = tuple(
        (e, "alpha")
        for e, shape in enumerate(fit.shapes)
        if Part.EXPONENT in parts and Part.EXPONENT not in shape.parts and fit.linear[e, VISCOUS] > 0.0
    )
    keys = (*inner, *opened)
    columns = weighted.tangent(fit, keys)
    final = wide = solve(problem, columns, prior=prior)
    if opened:
        narrow = solve(problem, columns[:, : -len(opened)], prior=prior)
        value = np.append(narrow.value, np.zeros(len(opened)))
        final = replace(wide, value=value, residual=narrow.residual, sigma=narrow.sigma, weights=narrow.weights)
    closed = np.where(wide.determined, wide.value - final.value, 0.0)
    # An exponent that would leave its range is not told by the runs: what it shifts has no meaning.
    steps = zip(opened, closed[len(closed) - len(opened) :].tolist(), strict=True)
    lost = {e for (e, _), step in steps if abs(step) > _MAX_EXPONENT_STEP}
    if lost:
        closed[: len(problem.names)] = 0.0
        closed[len(problem.names) + np.flatnonzero([e in lost for e, _ in keys])] = 0.0
    loaded, remarks = load_dependence(selected, columns, wide, prior)
    rises, covariance = undecided_parts(selected, columns, prior)
    free = without_bounds(selected, columns, wide, prior)
    shifts = np.column_stack([loaded, closed, free.shift, *blur_shifts(weighted, fit, columns)])
    known = final.covariance if covariance is None else covariance
    return keys, replace(final, covariance=known + shifts @ shifts.T), rises, free, remarks


def _block(element: int, inner: Sequence[Key], covariance: Array) -> Array:
    """Return the covariance of an element's parameters in FITTED, shape (8, 8); 0 for what is not fitted."""
    result, offset = np.zeros((len(FITTED), len(FITTED))), len(covariance) - len(inner)
    rows = [offset + k for k, (e, _) in enumerate(inner) if e == element]
    places = [FITTED.index(name) for e, name in inner if e == element]
    result[np.ix_(places, places)] = covariance[np.ix_(rows, rows)]
    return result


def _refusal(selected: Selection, element: int, parts: Sequence[Part], rise: tuple[float, float] | None) -> Refusal:
    """Return the function that says why an element does not have a part; `rise` is a Stribeck rise it may have."""
    low, high = selected.weighted.elements[element].speed_range

    def reason(part: Part) -> str:
        if (element, part) in selected.refused:
            why = selected.refused[element, part]
            if part is Part.STRIBECK and rise is not None:
                why += (
                    f"; a rise may be there, {100.0 * rise[0]:.0f} % of tau_c with a standard error of "
                    f"{100.0 * rise[1]:.0f} %: the deviations of the other parameters contain that"
                )
            return f"no {part.value} shows at speeds from {low:.3g} to {high:.3g} rad/s: {why}"
        if part is Part.DAMPING and ((element, Part.BRISTLE) in selected.refused or part in parts):
            return reason(Part.BRISTLE)
        return f"{part.value} was not tried"

    return reason


def _torque_reasons(selected: Selection, element: int, free: Unbounded) -> Mapping[str, str]:
    """Return why an element has no Coulomb or no viscous torque, by parameter; none for one that it has."""
    if not len(selected.weighted.elements[element].rows):
        return dict.fromkeys(LINEAR[:2], "at rest in all runs")
    sizes = {name: free.sizes[element, name] for name in LINEAR[:2] if (element, name) in free.sizes}
    texts = {name: f"{value:.3g} +- {deviation:.2g}" for name, (value, deviation) in sizes.items()}
    if selected.fit.linear[element].any():
        words = {"tau_c": "Coulomb", "c2": "viscous"}
        found = {
            name: f"no {words[name]} friction shows: without its bound 0 it would be {texts[name]}" for name in texts
        }
        whole = {name: f"the motion does not tell {name} from the rigid body" for name in LINEAR[:2]}
        return whole | found
    if not sizes:
        return dict.fromkeys(LINEAR[:2], "the element moves at one velocity alone")
    both = " and ".join(f"{name} {text}" for name, text in texts.items())
    drives = any(value < -_DRIVING_SE * deviation for value, deviation in sizes.values())
    why = "the torque drives the motion instead of opposing it (is its sign right?)" if drives else "no friction shows"
    return dict.fromkeys(LINEAR[:2], f"{why}: without the bound 0 the fit gives {both}")


def _constant_remarks(problem: ExcitationProblem, selected: Selection, fit: LinearFit) -> Iterable[str]:
    """Say for which joints tau_c is the mean of both directions: no motion tells their difference from an offset."""
    weighted = selected.weighted
    for joint, name in enumerate(problem.arm.names):
        constant = np.where(problem.joint == joint, weighted.weight, 0.0)
        left = constant - weighted.basis @ (weighted.basis.T @ constant)
        if constant.any() and np.linalg.norm(left) <= _CONSTANT_RESIDUAL * np.linalg.norm(constant):
            value = ""
            if (offset := f"offset_{joint + 1}") in problem.names:
                k = problem.names.index(offset)
                value = f", {fit.value[k]:.3g} Nm with a standard deviation of {fit.deviation[k]:.2g} Nm"
            yield (
                f"{name}: tau_c is the mean of both directions; their difference is a constant torque, which no motion "
                f"tells from the offset of the joint{value}"
            )


_DRIVING_SE = 4.0  # deviations of a negative friction torque from 0
_MAX_ALPHA_SD = 0.3  # deviation of an exponent that says nothing about it
_MAX_RELATIVE_SD = {"omega_s": 0.5, "delta": 0.5, "c0": 0.5, "c1": 0.25}
"""Relative deviation up to which one of these counts as known.

Damping is kept where it happens to come out large: of values that stand out by less than four deviations, most are too
large.
"""
_PART_OF = {
    "tau_s_positive": Part.STRIBECK, "tau_s_negative": Part.STRIBECK, "omega_s": Part.STRIBECK, "delta": Part.STRIBECK,
    "c0": Part.BRISTLE, "c1": Part.DAMPING,
}  # fmt: skip


def element_estimate(
    one: FittedElement, refusal: Refusal, torques: Mapping[str, str], sources: tuple[BagSource, ...]
) -> ElementEstimate:
    """Return the estimates of an element by the names of FrictionElement.

    Args:
        one: the element as it was fitted.
        refusal: why it does not have a part.
        torques: why its tau_c or c2 is 0, where it is.
        sources: the runs.
    """
    shape = one.shape
    tau_c, c2, c1 = one.linear.tolist()
    # Values, and their derivatives by the parameters of the fit.
    dry = (tau_c, {"tau_c": 1.0})
    static = dry
    omega_s: tuple[float, dict[str, float]] = (math.nan, {})
    c0 = omega_s
    if Part.STRIBECK in shape.parts:
        static = (tau_c * (1.0 + shape.rise), {"tau_c": 1.0 + shape.rise, "rise": tau_c})
        omega_s = (shape.omega_s, {"omega_s": shape.omega_s})
    if Part.BRISTLE in shape.parts:
        c0 = (tau_c * shape.stiffness, {"tau_c": shape.stiffness, "stiffness": tau_c * shape.stiffness})
    natural: dict[str, tuple[float, dict[str, float]]] = {
        "tau_c_positive": dry, "tau_c_negative": dry, "tau_s_positive": static, "tau_s_negative": static,
        "omega_s": omega_s, "delta": (shape.delta, {"delta": 1.0}), "c2": (c2, {"c2": 1.0}),
        "alpha": (shape.alpha, {"alpha": 1.0}), "c0": c0, "c1": (c1, {"c1": 1.0}),
    }  # fmt: skip
    jacobian = np.array([[slopes.get(name, 0.0) for name in FITTED] for _, slopes in natural.values()])
    known = np.isfinite(np.diag(one.covariance))
    covariance = jacobian @ np.where(np.outer(known, known), one.covariance, 0.0) @ jacobian.T
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    deviations[(jacobian[:, ~known] != 0.0).any(axis=1)] = math.inf
    estimates = {}
    for (name, (value, _)), deviation in zip(natural.items(), deviations.tolist(), strict=True):
        reason = _reason(one, name, value, deviation, refusal, torques)
        estimates[name] = ParameterEstimate.unknown(reason) if reason else ParameterEstimate(value, deviation)
    return ElementEstimate.of(one.element, estimates, covariance, sources)


def _reason(
    one: FittedElement, name: str, value: float, deviation: float, refusal: Refusal, torques: Mapping[str, str]
) -> str:
    """Return why a parameter is not known; empty if it is."""
    part = _PART_OF.get(name)
    if part is not None and part not in one.shape.parts:
        return refusal(part)
    if name == "delta" and "delta" in one.shape.fixed:
        return "not told from the size of the rise; 1 was assumed"
    limit = _MAX_ALPHA_SD if name == "alpha" else _MAX_RELATIVE_SD.get(name, math.inf) * value
    checks = (
        (name.startswith("tau") and value <= 0.0, torques["tau_c"] or "no Coulomb friction shows"),
        (name in ("c2", "alpha") and one.linear[VISCOUS] <= 0.0, torques["c2"] or "no viscous friction shows"),
        (not math.isfinite(value) or not math.isfinite(deviation), "the runs do not determine it"),
        (deviation > limit, f"standard deviation {deviation:.3g} at a value of {value:.3g}"),
    )
    return next((reason for applies, reason in checks if applies), "")
