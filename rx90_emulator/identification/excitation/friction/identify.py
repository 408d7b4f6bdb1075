"""The friction of all elements from excitation runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.friction.columns import element_rows
from rx90_emulator.identification.excitation.friction.estimates import element_estimate
from rx90_emulator.identification.excitation.friction.law import FITTED, LINEAR, VISCOUS, Part
from rx90_emulator.identification.excitation.friction.load import LoadDependence, load_dependence
from rx90_emulator.identification.excitation.friction.models import FittedElement, FrictionSelection
from rx90_emulator.identification.excitation.friction.selection import Selected, select_parts, tangent
from rx90_emulator.identification.excitation.friction.undecided import undecided_rises
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem

WITHOUT_BRISTLES = (Part.EXPONENT, Part.STRIBECK)
ALL_PARTS = tuple(Part)
_SAME = 1e-6  # share of a constant torque that the regressor may leave, to explain it


def identify_friction_parts(problem: ExcitationProblem, parts: Sequence[Part] = WITHOUT_BRISTLES) -> FrictionSelection:
    """Identify rigid body and friction together, and choose the friction's parts by cross-validation.

    Args:
        problem: the rows.
        parts: to try beside Coulomb and viscous friction, in this order; bristles take several times as long.

    Returns:
        The selection. Parameters that the runs do not tell are unknown, with a reason.
    """
    selected = select_parts(problem, parts)
    inner, final, load, rises = _final(selected, parts)
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


def _final(selected: Selected, parts: Sequence[Part]) -> _Final:
    """Return the friction's parameters and the fit of the whole model, linear around the one selected.

    Exponents that were tried and not kept stay at 1, but the covariance is that with them free: the runs say no more of
    tau_c and c2 because an exponent was left out; the same holds for a Stribeck rise that may be there. What the
    values shift with these exponents, and with a growth of friction with the load, widens the covariance, too.
    """
    weighted, fit = selected.weighted, selected.fit
    problem, inner = weighted.problem, fit.inner()
    open_ones = tuple(
        (e, "alpha")
        for e, shape in enumerate(fit.shapes)
        if Part.EXPONENT in parts and Part.EXPONENT not in shape.parts and fit.linear[e, VISCOUS] > 0.0
    )
    columns = tangent(weighted, fit, (*inner, *open_ones))
    wide = solve(problem, columns)
    load = load_dependence(weighted, fit, columns, wide)
    final = wide
    if open_ones:
        narrow = solve(problem, columns[:, : -len(open_ones)])
        value = np.concatenate([narrow.value, np.zeros(len(open_ones))])
        final = replace(wide, value=value, residual=narrow.residual, sigma=narrow.sigma, weights=narrow.weights)
    rises, covariance = undecided_rises(selected, columns)
    known = final.covariance if covariance is None else covariance
    closed = np.where(wide.determined, wide.value - final.value, 0.0)
    widened = replace(final, covariance=known + np.outer(load.shift, load.shift) + np.outer(closed, closed))
    return _Final((*inner, *open_ones), widened, load, rises)


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
        if part is Part.DAMPING and part in parts:
            return reason(Part.BRISTLE)
        return f"{part.value} was not tried"

    return reason


def _constant_remarks(problem: ExcitationProblem, selected: Selected, fit: LinearFit) -> tuple[str, ...]:
    """Say for which joints tau_c is the mean of both directions: no motion tells their difference from an offset."""
    weighted, remarks = selected.weighted, []
    for joint, name in enumerate(problem.arm.names):
        constant = np.where(problem.joint == joint, weighted.weight, 0.0)
        left = constant - weighted.basis @ (weighted.basis.T @ constant)
        if not constant.any() or np.linalg.norm(left) > _SAME * np.linalg.norm(constant):
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
