"""The friction of all elements from excitation runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.estimates import ElementEstimate
from rx90_emulator.identification.excitation.checks import coulomb_viscous
from rx90_emulator.identification.excitation.friction.estimates import (
    FittedElement,
    FrictionSelection,
    element_estimate,
)
from rx90_emulator.identification.excitation.friction.law import FITTED, LINEAR, VISCOUS, Part, element_rows
from rx90_emulator.identification.excitation.friction.selection import STAGES, Selected, attempts, select_parts, tangent
from rx90_emulator.identification.excitation.friction.unmodelled import (
    LoadDependence,
    blur_shifts,
    load_dependence,
    undecided_parts,
)
from rx90_emulator.identification.excitation.gains import DriveGains, drive_gains, with_gains
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.linear_parameters import Prior
from rx90_emulator.identification.excitation.problem import ExcitationProblem

WITHOUT_BRISTLES = (Part.EXPONENT, Part.STRIBECK)
ALL_PARTS = tuple(Part)
_MAX_EXPONENT_STEP = 0.8  # of an exponent from 1
_CONSTANT_RESIDUAL = 1e-6  # share of a constant torque that the regressor may leave, to explain it


def identify_friction_parts(
    problem: ExcitationProblem,
    parts: Sequence[Part] = WITHOUT_BRISTLES,
    prior: Prior | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> FrictionSelection:
    """Identify rigid body and friction together, and choose the friction's parts by cross-validation.

    Args:
        problem: the rows.
        parts: to try beside Coulomb and viscous friction, in this order; bristles take several times as long.
        prior: of the base parameters, for the values; the parts are chosen by the runs alone.
        progress: called with the name of each stage of the choice before it, `stages(parts)` times.

    Returns:
        The selection. Parameters that the runs do not tell are unknown, with a reason.
    """
    selected = select_parts(problem, parts, progress)
    inner, final, load, rises = _final(selected, parts, prior)
    size = problem.regressor.shape[1]
    shapes, linear = list(selected.fit.shapes), selected.fit.linear.copy()
    moved = [shape.values for shape in shapes]
    for (e, name), value in zip(inner, final.value[size:].tolist(), strict=True):
        if name in LINEAR:
            linear[e, LINEAR.index(name)] = value
        elif name in shapes[e].free:
            moved[e][shapes[e].free.index(name)] += value
    shapes = [shape.with_values(values) for shape, values in zip(shapes, moved, strict=True)]
    fitted = tuple(
        FittedElement(name, shapes[e], linear[e], _block(e, inner, final.covariance), rows.speeds)
        for e, (name, rows) in enumerate(zip(problem.arm.element_names, selected.weighted.elements, strict=True))
    )
    sources = tuple(run.source for run in problem.runs)
    friction = [f"{problem.arm.element_names[e]}.{name}" for e, name in inner]
    return FrictionSelection(
        models=selected.rows,
        blocks=selected.blocks,
        fitted=fitted,
        elements=tuple(
            element_estimate(one, _refusals(selected, e, parts, rises.get(e)), sources) for e, one in enumerate(fitted)
        ),
        fit=final,
        names=(*problem.names, *friction),
        predicted=problem.torque - final.residual,
        remarks=(*_constant_remarks(problem, selected, final), *_load_remarks(load)),
    )


def predicted_torque(selection: FrictionSelection, problem: ExcitationProblem) -> Array:
    """Return the torque of the rows of other runs of the same arm by the selected model, Nm, shape (r,).

    Raises:
        IdentificationError: for runs of another arm.
    """
    base = len(problem.names)
    if selection.names[:base] != problem.names:
        raise IdentificationError("runs with other base parameters than those identified; accepted: the same arm")
    torque = problem.regressor @ selection.fit.value[:base]
    for one, rows in zip(selection.fitted, element_rows(problem), strict=True):
        torque[rows.rows] += rows.columns(one.shape)[0] @ one.linear
    return np.asarray(torque)


class _Final(NamedTuple):
    """The friction's parameters, the fit of the whole model, and what friction may have beside its parts.

    `rises` are value and standard deviation over tau_c of Stribeck rises that may be there, by element.
    """

    inner: tuple[tuple[int, str], ...]
    fit: LinearFit
    load: LoadDependence
    rises: dict[int, tuple[float, float]]


def stages(parts: Sequence[Part]) -> int:
    """Return how many stages of the choice of parts are reported."""
    return len(attempts(parts)) * len(STAGES)


def identify_gains(
    problem: ExcitationProblem,
    parts: Sequence[Part] = WITHOUT_BRISTLES,
    progress: Callable[[str], None] = lambda _: None,
) -> DriveGains:
    """Identify drive gains: with Coulomb and viscous friction, then with the friction that predicts best with these.

    Args:
        problem: with known payloads in some runs.
        parts: of the friction, to try.
        progress: as in `identify_friction_parts`.

    Raises:
        IdentificationError: where the payloads tell no gain.
    """
    rough = drive_gains(problem, coulomb_viscous(problem)[1])
    scaled = with_gains(problem, rough)
    friction = identify_friction_parts(scaled, parts, progress=progress)
    return drive_gains(scaled, linear_columns(friction, scaled)[1]).after(rough.factor)


def linear_columns(selection: FrictionSelection, problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns of the linear friction parameters that a selection has, by its shapes, shape (r, f).

    Args:
        selection: the shapes.
        problem: of the same arm, along whose motion the columns are.
    """
    names, parts = [], []
    for one, rows in zip(selection.fitted, element_rows(problem), strict=True):
        taken = [k for k, name in enumerate(LINEAR) if f"{one.element}.{name}" in selection.names]
        part = np.zeros((len(problem), len(taken)))
        part[rows.rows] = rows.columns(one.shape)[0][:, taken]
        parts.append(part)
        names += [f"{one.element}.{LINEAR[k]}" for k in taken]
    return tuple(names), np.hstack(parts)


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
    places = np.array([selection.names.index(name) for name in names], dtype=np.intp)
    covariance = _with_shapes_unknown(selection.fit.covariance, places, fit.covariance)
    value = np.zeros(len(selection.names))
    value[places] = fit.value
    pairs = [name.rpartition(".") for name in selection.names[len(problem.names) :]]
    inner = [(problem.arm.element_names.index(element), name) for element, _, name in pairs]
    values = dict(zip(names, fit.value.tolist(), strict=True))
    fitted = [
        replace(
            one,
            linear=np.array([values.get(f"{one.element}.{name}", 0.0) for name in LINEAR]),
            covariance=_block(e, inner, covariance),
        )
        for e, one in enumerate(selection.fitted)
    ]
    elements = [
        element_estimate(one, _previous_reason(old), old.sources)
        for one, old in zip(fitted, selection.elements, strict=True)
    ]
    other = replace(selection, fitted=tuple(fitted), elements=tuple(elements), fit=replace(fit, value=value))
    predicted = predicted_torque(other, problem)
    whole = replace(other.fit, covariance=covariance, residual=problem.torque - predicted)
    return replace(other, fit=whole, predicted=predicted)


def _with_shapes_unknown(covariance: Array, places: NDArray[np.intp], linear: Array) -> Array:
    """Return a covariance with that of a fit of its linear parameters for given shapes, and what is not known of these.

    Args:
        covariance: of all parameters, shape (q, q).
        places: of the linear ones, shape (k,).
        linear: their covariance for given shapes, shape (k, k).
    """
    shapes = np.setdiff1d(np.arange(len(covariance)), places)
    between = covariance[np.ix_(shapes, shapes)]
    slope = covariance[np.ix_(places, shapes)] @ np.linalg.pinv(between)
    whole = covariance.copy()
    whole[np.ix_(places, places)] = linear + slope @ between @ slope.T
    return whole


def _previous_reason(estimate: ElementEstimate) -> Callable[[Part], str]:
    """Return why an element does not have a part, as its estimate says."""
    of = {Part.STRIBECK: "omega_s", Part.BRISTLE: "c0", Part.DAMPING: "c1"}
    return lambda part: estimate.parameters[of[part]].reason


def _final(selected: Selected, parts: Sequence[Part], prior: Prior | None = None) -> _Final:
    """Return the friction's parameters and the fit of the whole model, linear around the one selected.

    Exponents that were tried and not kept stay at 1, but the covariance is that with them free: the runs say no more of
    tau_c and c2 because an exponent was left out; the same holds for a Stribeck rise, or the damping of a bristle, that
    may be there. What the values shift with these exponents, with a growth of friction with the load, and with a motion
    that is known less sharply, widens the covariance, too.
    """
    weighted, fit = selected.weighted, selected.fit
    problem, inner = weighted.problem, fit.inner()
    open_ones = tuple(
        (e, "alpha")
        for e, shape in enumerate(fit.shapes)
        if Part.EXPONENT in parts and Part.EXPONENT not in shape.parts and fit.linear[e, VISCOUS] > 0.0
    )
    columns = tangent(weighted, fit, (*inner, *open_ones))
    wide = solve(problem, columns, prior=prior)
    load = load_dependence(weighted, fit, columns, wide, prior)
    final = wide
    if open_ones:
        narrow = solve(problem, columns[:, : -len(open_ones)], prior=prior)
        value = np.concatenate([narrow.value, np.zeros(len(open_ones))])
        final = replace(wide, value=value, residual=narrow.residual, sigma=narrow.sigma, weights=narrow.weights)
    open_parts, covariance = undecided_parts(selected, columns, prior)
    known = final.covariance if covariance is None else covariance
    closed = _exponent_bias(wide, final, (*inner, *open_ones), len(open_ones))
    shifts = np.column_stack([load.shift, closed, *blur_shifts(weighted, fit, columns)])
    widened = replace(final, covariance=known + shifts @ shifts.T)
    rises = {e: size for (e, part), size in open_parts.items() if part is Part.STRIBECK}
    return _Final((*inner, *open_ones), widened, load, rises)


def _exponent_bias(wide: LinearFit, narrow: LinearFit, inner: Sequence[tuple[int, str]], opened: int) -> Array:
    """Return what all values shift with exponents that were left at 1, the last `opened` values, shape (q,).

    An exponent that would leave its range is not told by the runs: what it shifts has no meaning.
    """
    shift = np.where(wide.determined, wide.value - narrow.value, 0.0)
    lost = {e for (e, _), step in zip(inner[len(inner) - opened :], shift[len(shift) - opened :], strict=True)
            if abs(step) > _MAX_EXPONENT_STEP}  # fmt: skip
    if lost:
        shift[: len(shift) - len(inner)] = 0.0
    for place, (e, _) in enumerate(inner, len(shift) - len(inner)):
        if e in lost:
            shift[place] = 0.0
    return shift


def _block(element: int, inner: Sequence[tuple[int, str]], covariance: Array) -> Array:
    """Return the covariance of an element's parameters in FITTED, shape (8, 8); 0 for what is not fitted."""
    result = np.zeros((len(FITTED), len(FITTED)))
    offset = len(covariance) - len(inner)
    rows = [offset + k for k, (e, _) in enumerate(inner) if e == element]
    places = [FITTED.index(name) for e, name in inner if e == element]
    result[np.ix_(places, places)] = covariance[np.ix_(rows, rows)]
    return result


def _refusals(
    selected: Selected, element: int, parts: Sequence[Part], rise: tuple[float, float] | None
) -> Callable[[Part], str]:
    """Return the function that says why an element does not have a part; `rise` is a Stribeck rise it may have."""
    low, high = selected.weighted.elements[element].speed_range

    def reason(part: Part) -> str:
        if (element, part) in selected.refused:
            why = selected.refused[element, part]
            if part is Part.STRIBECK and rise is not None:
                size, deviation = (100.0 * value for value in rise)
                why += (
                    f"; a rise may be there, {size:.0f} % of tau_c with a standard error of {deviation:.0f} %: the "
                    "deviations of the other parameters contain that"
                )
            return f"no {part.value} shows at speeds from {low:.3g} to {high:.3g} rad/s: {why}"
        if part is Part.DAMPING and ((element, Part.BRISTLE) in selected.refused or part in parts):
            return reason(Part.BRISTLE)
        return f"{part.value} was not tried"

    return reason


def _constant_remarks(problem: ExcitationProblem, selected: Selected, fit: LinearFit) -> tuple[str, ...]:
    """Say for which joints tau_c is the mean of both directions: no motion tells their difference from an offset."""
    weighted, remarks = selected.weighted, []
    for joint, name in enumerate(problem.arm.names):
        constant = np.where(problem.joint == joint, weighted.weight, 0.0)
        left = constant - weighted.basis @ (weighted.basis.T @ constant)
        if not constant.any() or np.linalg.norm(left) > _CONSTANT_RESIDUAL * np.linalg.norm(constant):
            continue
        offset, value = f"offset_{joint + 1}", ""
        if offset in problem.names:
            place = problem.names.index(offset)
            value = f", {fit.value[place]:.3g} Nm with a standard deviation of {fit.deviation[place]:.2g} Nm"
        remarks.append(
            f"{name}: tau_c is the mean of both directions; their difference is a constant torque, which no motion "
            f"tells from the offset of the joint{value}"
        )
    return tuple(remarks)


def _load_remarks(load: LoadDependence) -> tuple[str, ...]:
    if not load.significant:
        return ()
    size = f"{100.0 * load.value:.2g} % with a standard deviation of {100.0 * load.deviation:.2g} %"
    return (
        f"Coulomb friction changes with the load, at a joint's RMS torque by {size}: tau_c holds at the usual load of "
        "the runs, and its deviation contains the difference to no load",
    )
