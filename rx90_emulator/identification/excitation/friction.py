"""The friction of all elements from excitation runs: selected parts, values with deviations, and reasons for gaps.

The selected model is fitted once more, linear around its shapes, with deviations that include neglected effects; its
values are converted to the parameters of FrictionElement, or to the reason why a parameter is not identifiable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.choice import (
    ModelRow,
    Selection,
    TimeBlocks,
    select_parts,
)
from rx90_emulator.identification.excitation.final_fit import FinalFit
from rx90_emulator.identification.excitation.fit import Key, LinearFit
from rx90_emulator.identification.excitation.law import (
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

NORMAL_95 = 1.96
_CURVE_POINTS = 60  # of each direction
WITHOUT_BRISTLES = (Part.EXPONENT, Part.STRIBECK)
ALL_PARTS = tuple(Part)
Refusal = Callable[[Part], str]
"""Returns why an element does not have a part."""


class FrictionCurve(NamedTuple):
    """Steady friction torque of an element over its velocity, in the range of velocities with data.

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
    """The fitted friction of one element.

    Attributes:
        element: its name.
        shape: its parts, and the parameters that are not linear.
        linear: tau_c, c2 and c1, in Nm, Nm (s/rad)^alpha, Nm s/rad; 0 for parts it does not have, shape (3,).
        covariance: of the parameters in FITTED, shape (8, 8); 0 for those not fitted. If exponents were requested, the
            viscous exponent is free in it even where the value stays 1, because its uncertainty adds to that of tau_c
            and c2.
        ranges: least and greatest speed of its data in positive and negative direction: ((low, high), (low, high)),
            rad/s; (0, 0) for a direction in which it did not move.
    """

    element: str
    shape: ElementShape
    linear: Array
    covariance: Array
    ranges: tuple[tuple[float, float], tuple[float, float]]

    def curve(self) -> FrictionCurve:
        """Return the steady friction torque with its deviation, over all velocities with data."""
        back, forward = (
            np.geomspace(*pair, _CURVE_POINTS) if pair[1] > 0.0 else np.empty(0) for pair in self.ranges[::-1]
        )
        velocity = np.concatenate([-back[::-1], forward])
        columns, slopes = steady_columns(self.shape, velocity)
        by_shape = [
            slopes[name] * self.linear[place] if name in slopes else 0.0 * velocity for name, place in SHAPED.items()
        ]
        matrix = np.column_stack([columns, *by_shape])
        variance = np.einsum("ki,ij,kj->k", matrix, self.covariance, matrix)
        return FrictionCurve(self.element, velocity, columns @ self.linear, np.sqrt(np.maximum(variance, 0.0)))


def steady_columns(shape: ElementShape, velocity: Array) -> tuple[Array, dict[str, Array]]:
    """Return the factors of the linear parameters in steady sliding, shape (m, 3), and their derivatives.

    Args:
        shape: of the element.
        velocity: rad/s, shape (m,).

    Returns:
        Columns of LINEAR, and by each other parameter the derivative of the column that it shapes, as in SHAPED.
    """
    speeds = Speeds.of(velocity)
    (dry, slopes) = coulomb(shape, speeds)
    (wet, by_alpha) = viscous(shape, speeds)
    return np.column_stack([dry, wet, np.zeros_like(velocity)]), {"alpha": by_alpha, **slopes}


@dataclass(frozen=True, eq=False)
class FrictionSelection:
    """The friction of all elements with the selected parts, and the compared models.

    Attributes:
        models: rows of the table, in the order in which they were compared.
        blocks: of the cross-validation.
        fitted: the fitted elements, in the arm's order.
        elements: their estimates by the names of FrictionElement, with the reason for each that is not identifiable.
        fit: of the selected model, linear around the non-linear parameters (whose values in it are their last changes):
            the problem's parameters, then the friction's, with HAC covariance. Its last values may be exponents that
            stay at 1, and whose uncertainty the covariance includes.
        names: of the values of `fit`; a friction parameter is `element.parameter`.
        predicted: torque of every row by the selected model, Nm, shape (r,).
        remarks: notes for readers of the figures.
        warnings: on elements whose friction deviates from the model.
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
        """Return the curves of all elements over the velocities with data."""
        return tuple(one.curve() for one in self.fitted)


def identify_friction_parts(
    problem: ExcitationProblem,
    parts: Sequence[Part] = WITHOUT_BRISTLES,
    prior: Prior | None = None,
    progress: Callable[[str], None] = lambda _: None,
    *,
    fixed: bool = False,
) -> FrictionSelection:
    """Identify rigid body and friction together, and select the friction's parts by cross-validation.

    Args:
        problem: the rows.
        parts: to try beside Coulomb and viscous friction, in this order; bristles take several times as long.
        prior: of the base parameters, for the values; the parts are selected by the runs alone.
        progress: called with the name of each part before its trial.
        fixed: whether all elements have the parts, without selection.

    Returns:
        The selection. Parameters that the runs do not determine are unknown, with a reason.
    """
    selected = select_parts(problem, parts, progress, fixed=fixed)
    final = FinalFit(selected, parts, prior)
    names = problem.arm.element_names
    models = zip(selected.fit.shapes, selected.weighted.elements, strict=True)
    nothing = np.zeros(len(LINEAR)), np.zeros((len(FITTED),) * 2)
    initial = [
        FittedElement(name, shape, *nothing, rows.speeds) for name, (shape, rows) in zip(names, models, strict=True)
    ]
    fitted = _with_values(initial, final.inner, final.fit.value, final.fit.covariance)
    sources = tuple(run.source for run in problem.runs)
    refusals = [_refusal(selected, e, parts, final.rises.get(e)) for e in range(len(fitted))]
    reasons = [_torque_reasons(selected, e, final.unbounded) for e in range(len(fitted))]
    return FrictionSelection(
        models=tuple(selected.rows),
        blocks=selected.blocks,
        fitted=fitted,
        elements=tuple(element_estimate(*three, sources) for three in zip(fitted, refusals, reasons, strict=True)),
        fit=final.fit,
        names=(*problem.names, *(f"{names[e]}.{name}" for e, name in final.inner)),
        predicted=problem.torque - final.fit.residual,
        remarks=(*_constant_remarks(problem, selected, final.fit), *final.remarks),
        warnings=tuple(final.warnings),
    )


def _with_values(
    elements: Sequence[FittedElement], inner: Sequence[Key], values: Array, covariance: Array
) -> tuple[FittedElement, ...]:
    """Return elements with the linear parameters of a fit, 0 for others, and with its changes of their shapes.

    Args:
        elements: with the shapes around which the fit is linear.
        inner: the friction's parameters, the last ones of the fit.
        values: of the fit, shape (q,).
        covariance: of these, shape (q, q).
    """
    found = []
    first = len(values) - len(inner)
    for e, one in enumerate(elements):
        rows = [first + k for k, (element, _) in enumerate(inner) if element == e]
        names = [inner[row - first][1] for row in rows]
        places = [FITTED.index(name) for name in names]
        known = dict(zip(names, values[rows].tolist(), strict=True))
        block = np.zeros((len(FITTED), len(FITTED)))
        block[np.ix_(places, places)] = covariance[np.ix_(rows, rows)]
        shape = one.shape.with_values(one.shape.values + np.array([known.get(name, 0.0) for name in one.shape.free]))
        linear = np.array([known.get(name, 0.0) for name in LINEAR])
        found.append(replace(one, shape=shape, linear=linear, covariance=block))
    return tuple(found)


def predicted_torque(selection: FrictionSelection, problem: ExcitationProblem) -> Array:
    """Return the torque of the rows of other runs of the same arm by the selected model, Nm, shape (r,)."""
    columns = joint_columns(problem, [one.shape for one in selection.fitted])
    linear = np.array([one.linear for one in selection.fitted])
    rigid = problem.regressor @ selection.fit.value[: len(problem.names)]
    return np.asarray(rigid + np.tensordot(columns, linear, 2))


def linear_columns(selection: FrictionSelection, problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns of the linear friction parameters of a selection, for its shapes, shape (r, f).

    Args:
        selection: the shapes.
        problem: of the same arm; the columns are along its motion.
    """
    names = [f"{one.element}.{name}" for one in selection.fitted for name in LINEAR]
    there = [k for k, name in enumerate(names) if name in selection.names]
    columns = joint_columns(problem, [one.shape for one in selection.fitted]).reshape(len(problem), -1)
    return tuple(names[k] for k in there), columns[:, there]


_CONSTANT_RESIDUAL = 1e-6  # largest unexplained share of a constant torque that the regressor explains


def _refusal(selected: Selection, element: int, parts: Sequence[Part], rise: tuple[float, float] | None) -> Refusal:
    """Return the function that gives the reason why an element lacks a part; `rise` is a Stribeck rise it may have."""
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


def _torque_reasons(
    selected: Selection, element: int, unbounded: Mapping[Key, tuple[float, float]]
) -> Mapping[str, str]:
    """Return why an element has no Coulomb or no viscous torque, by parameter; empty if it has both."""
    if not len(selected.weighted.elements[element].rows):
        return dict.fromkeys(LINEAR[:2], "at rest in all runs")
    sizes = {name: unbounded[element, name] for name in LINEAR[:2] if (element, name) in unbounded}
    texts = {name: f"{value:.3g} +- {deviation:.2g}" for name, (value, deviation) in sizes.items()}
    if selected.fit.linear[element].any():
        words = {"tau_c": "Coulomb", "c2": "viscous"}
        found = {
            name: f"no {words[name]} friction shows: without its bound 0 it would be {texts[name]}" for name in texts
        }
        whole = {name: f"the motion does not distinguish {name} from the rigid body" for name in LINEAR[:2]}
        return whole | found
    if not sizes:
        return dict.fromkeys(LINEAR[:2], "the element moves at one velocity alone")
    both = " and ".join(f"{name} {text}" for name, text in texts.items())
    drives = any(value < -_DRIVING_SE * deviation for value, deviation in sizes.values())
    why = "the torque drives the motion instead of opposing it (is its sign right?)" if drives else "no friction shows"
    return dict.fromkeys(LINEAR[:2], f"{why}: without the bound 0 the fit gives {both}")


def _constant_remarks(problem: ExcitationProblem, selected: Selection, fit: LinearFit) -> Iterable[str]:
    """Yield for which joints tau_c is the mean of both directions: their difference equals an offset in all motions."""
    weighted = selected.weighted
    for joint, name in enumerate(problem.arm.names):
        constant = np.where(problem.joint == joint, weighted.weight, 0.0)
        residual = constant - weighted.basis @ (weighted.basis.T @ constant)
        if constant.any() and np.linalg.norm(residual) <= _CONSTANT_RESIDUAL * np.linalg.norm(constant):
            value = ""
            if (offset := f"offset_{joint + 1}") in problem.names:
                k = problem.names.index(offset)
                value = f", {fit.value[k]:.3g} Nm with a standard deviation of {fit.deviation[k]:.2g} Nm"
            yield (
                f"{name}: tau_c is the mean of both directions; their difference is a constant torque, which no "
                f"motion distinguishes from the offset of the joint{value}"
            )


_DRIVING_SE = 4.0  # deviations of a negative friction torque from 0
_MAX_ALPHA_SD = 0.3  # deviation above which an exponent is not identifiable
_MAX_RELATIVE_SD = {"omega_s": 0.5, "delta": 0.5, "c0": 0.5, "c1": 0.25}
"""Relative deviation up to which one of these is identifiable.

The damping is selected where it happens to come out large: most values that exceed 0 by less than four deviations are
too large.
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
        refusal: gives the reason why it does not have a part.
        torques: why its tau_c or c2 is 0, if it is.
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
    """Return why a parameter is not identifiable; empty if it is."""
    part = _PART_OF.get(name)
    if part is not None and part not in one.shape.parts:
        return refusal(part)
    if name == "delta" and "delta" in one.shape.fixed:
        return "not distinguished from the size of the rise; 1 was assumed"
    limit = _MAX_ALPHA_SD if name == "alpha" else _MAX_RELATIVE_SD.get(name, math.inf) * value
    checks = (
        (name.startswith("tau") and value <= 0.0, torques["tau_c"] or "no Coulomb friction shows"),
        (name in ("c2", "alpha") and one.linear[VISCOUS] <= 0.0, torques["c2"] or "no viscous friction shows"),
        (not math.isfinite(value) or not math.isfinite(deviation), "the runs do not determine it"),
        (deviation > limit, f"standard deviation {deviation:.3g} at a value of {value:.3g}"),
    )
    return next((reason for applies, reason in checks if applies), "")
