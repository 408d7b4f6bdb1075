"""Terminal output of an identification and of a check of a friction file: tables and sentences.

Pages have the same sentences; `report` adds the plots.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

from rx90_common.estimation.law import Part
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_UNITS
from rx90_emulator.identification.estimates import (
    FrictionCurve,
    IdentifiedElement,
    ParameterEstimate,
)
from rx90_emulator.identification.fitted import PART_OF
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import (
    ExcitationIdentification,
    FrictionIdentification,
    Identification,
)
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import verdict

_NEGATIVE = 3.0  # deviations below 0 from which a negative rotor inertia is significant
_REPORTED = ("tau_c", "c2", "alpha", "tau_s", "omega_s", "delta", "c0", "c1")
_Value = TypeVar("_Value", bound=Hashable)


def number(value: float, form: str = ".3f") -> str:
    """Return a number in a format; a dash for NaN, which means not compared."""
    return "-" if math.isnan(value) else f"{value:{form}}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first column left-aligned, the others right-aligned."""
    lines = [head, *rows]
    widths = [2 + max(map(len, column)) for column in zip(*lines, strict=True)]
    return [
        f"{name:<{widths[0]}}"
        + "".join(f"{cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True))
        for name, *cells in lines
    ]


def together(values: Iterable[tuple[str, _Value]]) -> list[tuple[str, _Value]]:
    """Return values with the names that have them, each value once."""
    names: dict[_Value, list[str]] = {}
    for name, value in values:
        names.setdefault(value, []).append(name)
    return [(", ".join(those), value) for value, those in names.items()]


def identification_summary(result: Identification) -> str:
    """Return values with deviations, what is not identified with reasons, goodness of fit, alarms and verdicts."""
    lines = in_currents(result)
    lines += _friction_lines(result)
    if isinstance(result, FrictionIdentification):
        lines += _sweep_lines(result)
    if isinstance(result, ExcitationIdentification):
        lines += _excitation_lines(result)
    lines += [f"alarm: {alarm}" for alarm in result.alarms]
    lines += [validation_verdict(check, result.scope) for check in result.validations]
    return in_unit("\n".join(lines), result.unit)


def _friction_lines(result: Identification) -> list[str]:
    """Return the table of identified values, true ones below where they are known, and the reasons for the others."""
    names = result.arm.element_names
    shown = friction_rows(names, result.elements)
    columns = friction_columns(shown)
    truth = true_elements(result)
    rows = []
    for name, estimates in shown.items():
        rows.append([name, *(_with_deviation(estimates.get(column)) for column, _ in columns)])
        if name in truth:
            rows.append(
                ["  true", *(f"{true_value(truth[name], column):.6g}" for column, _ in columns)]
            )
    lines = table(["element", *(f"{name}, {unit}" for name, unit in columns)], rows)
    if rows:
        lines.append("+- is one standard deviation; 95 % lie within 1.96 of them")
    nothing = [name for name in names if name not in shown]
    if nothing:
        lines.append(f"{', '.join(nothing)}: nothing identified")
    # Where elements have different reasons, the report gives them.
    lines += [
        f"not identified: {parameters} of {whose}: {reasons[0] if len(reasons) == 1 else 'reasons in the report'}"
        for parameters, whose, reasons in lacking(names, result.elements)
    ]
    return lines


def true_elements(result: Identification) -> Mapping[str, FrictionElement]:
    """Return the elements that emulated runs were made with, by name; empty where none are known."""
    return result.truth if isinstance(result, FrictionIdentification) else {}


def _with_deviation(estimate: ParameterEstimate | None) -> str:
    if estimate is None or not estimate.identifiable:
        return "-"
    value, deviation = estimate.texts()
    return f"{value} +- {deviation}" if estimate.deviation else value


def _sweep_lines(result: FrictionIdentification) -> list[str]:
    """Return how well the curves fit, and what was used of each bag of sweeps."""
    fits = [f"fit of {name}: {fit_text(curve)}" for name, curve in result.curves.items()]
    uses = [f"{use.bag.path}: {use.text(result.arm.element_names)}" for use in result.sliding.usage]
    return [
        *fits,
        f"recorded over described weight: {', '.join(map(' '.join, scale_texts(result)))}",
        *uses,
    ]


def scale_texts(result: FrictionIdentification) -> list[tuple[str, str]]:
    """Return how many times the torque that the described bodies need was recorded, by joint, or that none can tell."""
    scales = result.sliding.scales.items()
    return [
        (joint, "cannot be told" if math.isnan(scale) else f"{scale:.3g}")
        for joint, scale in scales
    ]


def fit_text(curve: FrictionCurve) -> str:
    """Return the goodness of fit of an element's curve in words."""
    return (
        f"residual {curve.rms:.3g} Nm RMS, {curve.share:.2%} of its friction, chi2 {curve.chi2:.3g}"
    )


def _excitation_lines(result: ExcitationIdentification) -> list[str]:
    """Return goodness of fit, moved bodies, the selected model, and what was left out and why."""
    lines = []
    if followed := ", ".join(result.robot.followed):
        lines.append(f"not identified, along their recorded motion: {followed}")
    if unknown := ", ".join(result.undetermined):
        lines.append(
            f"not determined by these runs: {unknown}; the files take them from the description"
        )
    runs = [("fitted", run) for run in result.torques]
    for check in result.validations:
        predictions = (
            ("unseen", check.fitted),
            ("simplest", check.simplest),
            ("files", check.torque),
        )
        runs += [(use, run) for use, run in predictions if run is not None]
    shares = [
        [
            f"{use} {run.source.path.name}",
            *(number(value, ".1%") for value in (*run.share, run.total_share)),
        ]
        for use, run in runs
    ]
    head = f"torque RMS below {result.compared.torque:.3g} Hz"
    lines += table([head, *result.torques[0].names, "all"], shares)
    bodies = [
        (
            moved.joint,
            *(
                f"{before:.3g} / {after:.3g}"
                for before, after in (moved.mass, moved.moment, moved.inertia)
            ),
        )
        for moved in result.bodies
    ]
    lines += table(
        ("moved: described / files", "mass, kg", "first moment, kg m", "inertia, kg m^2"), bodies
    )
    bandwidths = result.problem.runs[0].bandwidths
    lines.append(
        f"low-pass of the fit: {bandwidths.position:.3g} Hz, torques {bandwidths.torque:.3g} Hz: {bandwidths.reason}"
    )
    lines += [note if note.startswith("warning") else f"recording: {note}" for note in result.notes]
    lines.append(f"model: {kept_parts(result)}")
    lines += filter(None, (result.consistency.text, result.consistency.open_text))
    return [
        *lines,
        *(f"warning: {warning}" for warning in (*result.warnings, *bodies_warnings(result))),
    ]


def in_currents(result: Identification) -> list[str]:
    """Return a warning if torques are currents, which a simulation must not use as torques; else nothing."""
    if result.unit == "Nm":
        return []
    return [
        f"warning: efforts in {result.unit} and no torque constants: friction, inertias and the files are in that "
        "scale, and no simulation should load them"
    ]


def kept_parts(result: ExcitationIdentification) -> str:
    """Return in words the parts of the selected friction, and which elements have them; * where values stay open."""
    texts = ["Coulomb + viscous"]
    is_open = False
    elements = [*zip(result.arm.element_names, result.fitted.laws, result.elements, strict=True)]
    for part in Part:
        values = [name for name, owner in PART_OF.items() if owner is part]
        having = []
        for name, law, element in elements:
            if part in law.parts:
                known = all(element.estimates[value].identifiable for value in values)
                having.append(name if known else f"{name}*")
                is_open |= not known
        if having:
            texts.append(f"{part.value}: {', '.join(having)}")
    text = " + ".join(texts)
    if not is_open:
        return text
    compared = "fits better so, but its " if result.fitted.trials else ""
    return f"{text}; * {compared}parameters stay open"


def bodies_warnings(result: ExcitationIdentification) -> list[str]:
    """Return whether the bodies in the files are far from the base parameters, and which rotors are below 0."""
    warnings = [result.consistency.warning] if result.consistency.warning else []
    rotors = {f"Ia_{number}": name for number, name in enumerate(result.arm.names, 1)}
    below = []
    for parameter in result.base:
        estimate = parameter.estimate
        if (
            parameter.group in rotors
            and estimate.identifiable
            and estimate.value < -_NEGATIVE * estimate.deviation
        ):
            below.append(f"{rotors[parameter.group]} {' +- '.join(estimate.texts())} kg m^2")
    if below:
        warnings.append(
            f"rotor inertias came out below 0: {', '.join(below)}; torques of sensors between gear and link hold no "
            "rotors (--no-rotors)"
        )
    return warnings


def verdict_words(check: Validation) -> str:
    """Return what a validation says in two words or three."""
    if not check.passed:
        return "not confirmed"
    return "confirmed, but the alarms stand" if check.alarms else "confirmed"


def validation_verdict(check: Validation, scope: str = "") -> str:
    """Return the verdict of a bag on friction, with the decisive joints, values and limits.

    Args:
        check: of the bag.
        scope: which values are assumed, in words, where the friction was identified.
    """
    behind = f" by a bag that the fit did not use; {scope}" if scope else ""
    said = "confirmed, but the alarms stand" if check.alarms else "confirmed"
    words = (f"{said}{behind}", f"NOT CONFIRMED{behind}")
    return verdict(f"validation {check.source}", words, *check.criteria, *check.remarks)


def check_summary(checks: Sequence[Validation]) -> str:
    """Return a table of the joints and the verdict for each bag that a friction file was compared with."""
    lines = []
    for check in checks:
        values = zip(
            check.names, check.rms, check.rms_share, check.worst, check.worst_share, strict=True
        )
        rows = [
            (name, number(a), number(b, ".2%"), number(c), number(d, ".2%"))
            for name, a, b, c, d in values
        ]
        lines += table(("joint", "RMS, Nm", "of torque", "worst, Nm", "of largest"), rows)
        lines += [f"alarm: {alarm}" for alarm in check.alarms]
        lines += [f"recording: {text}" for text in check.notes]
        lines.append(validation_verdict(check))
    return in_unit("\n".join(lines), checks[0].unit)


def friction_rows(
    names: Sequence[str], elements: Sequence[IdentifiedElement]
) -> dict[str, dict[str, ParameterEstimate]]:
    """Return the estimates of each element of which something is identified, in the order of tables."""
    rows = {name: _by_column(identified) for name, identified in zip(names, elements, strict=True)}
    return {
        name: row
        for name, row in rows.items()
        if any(estimate.identifiable for estimate in row.values())
    }


def friction_columns(
    rows: Mapping[str, Mapping[str, ParameterEstimate]],
) -> list[tuple[str, str]]:
    """Return the parameters that are identified of any element, with their units."""
    known = {
        column for row in rows.values() for column, estimate in row.items() if estimate.identifiable
    }
    units = {name.removesuffix("_positive"): unit for name, unit in FRICTION_UNITS.items()}
    return [
        (column, units[name])
        for name in _REPORTED
        for column in (name, f"{name}+", f"{name}-")
        if column in known
    ]


def true_value(element: FrictionElement, column: str) -> float:
    """Return the value of an element that stands in a column of the table."""
    name = column.replace("+", "_positive").replace("-", "_negative")
    values = element.parameters
    return values[name] if name in values else values[f"{name}_positive"]


def _by_column(identified: IdentifiedElement) -> dict[str, ParameterEstimate]:
    """Return estimates by the names of columns; both signs as one where they are equal."""
    estimates = identified.estimates
    columns = {}
    for name in _REPORTED:
        if name in estimates:
            columns[name] = estimates[name]
        elif f"{name}_positive" in estimates:
            positive = estimates[f"{name}_positive"]
            negative = estimates[f"{name}_negative"]
            unknown = (
                not positive.identifiable
                and not negative.identifiable
                and positive.reason == negative.reason
            )
            if unknown or positive == negative:
                columns[name] = positive
            else:
                columns |= {f"{name}+": positive, f"{name}-": negative}
    return columns


def lacking(
    names: Sequence[str], elements: Sequence[IdentifiedElement]
) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return unidentified parameters with their elements and reasons, grouped by elements."""
    reasons: dict[str, tuple[tuple[str, str], ...]] = {}  # by parameter: elements with the reasons
    for element, identified in zip(names, elements, strict=True):
        for name, estimate in _by_column(identified).items():
            if not estimate.identifiable:
                reasons[name] = (*reasons.get(name, ()), (element, estimate.reason))
    groups = []
    for parameters, pairs in together(reasons.items()):
        whose = (
            "all elements"
            if len(pairs) == len(names)
            else ", ".join(element for element, _ in pairs)
        )
        texts = together(pairs)
        words = [
            reason if len(texts) == 1 else f"{elements}: {reason}" for elements, reason in texts
        ]
        groups.append((parameters, whose, tuple(words)))
    return groups
