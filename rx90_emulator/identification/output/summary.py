"""Terminal output of an identification and of a check of a friction file: tables and sentences.

Pages have the same sentences; `report` adds the plots.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

from rx90_common.base.quoting import aligned
from rx90_common.estimation.law import Part
from rx90_common.friction.element import FRICTION_UNITS
from rx90_emulator.identification.estimates import ParameterEstimate
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
    return aligned([head, *rows], right=range(1, len(head)))


def identification_summary(result: Identification) -> str:
    """Return values with deviations, what is not identified with reasons, goodness of fit, alarms and verdicts."""
    lines = _friction_lines(result)
    if isinstance(result, FrictionIdentification):
        names = result.arm.element_names
        lines += [
            f"fit of {name}: residual {curve.rms:.3g} Nm RMS, {curve.share:.2%} of its friction"
            for name, curve in result.curves.items()
        ]
        lines += [f"{use.bag.path}: {use.text(names)}" for use in result.sliding.usage]
    if isinstance(result, ExcitationIdentification):
        lines += _excitation_lines(result)
    lines += [f"alarm: {alarm}" for alarm in result.alarms]
    lines += [validation_verdict(check, result.scope) for check in result.validations]
    return in_unit("\n".join(lines), result.unit)


def _friction_lines(result: Identification) -> list[str]:
    """Return the table of identified values, and the reasons for the others."""
    names = result.arm.element_names
    shown = friction_rows(result)
    columns = friction_columns(shown)
    rows = [
        [name, *(_with_deviation(estimates.get(column)) for column, _ in columns)]
        for name, estimates in shown.items()
    ]
    lines = table(["element", *(f"{name}, {unit}" for name, unit in columns)], rows)
    if rows:
        lines.append("+- is one standard deviation; 95 % lie within 1.96 of them")
    nothing = [name for name in names if name not in shown]
    if nothing:
        lines.append(f"{', '.join(nothing)}: nothing identified")
    lines += [
        f"not identified: {parameters} of {whose}: {reason}"
        for parameters, whose, reason in lacking(result)
    ]
    return lines


def _with_deviation(estimate: ParameterEstimate | None) -> str:
    if estimate is None or not estimate.identifiable:
        return "-"
    value, deviation = estimate.texts()
    return f"{value} +- {deviation}" if estimate.deviation else value


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
            *(number(value, ".1%") for value in (*run.rms_share, run.total_share)),
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
        f"low-pass of the fit: {bandwidths.position:.3g} Hz, torques {bandwidths.torque:.3g} Hz"
    )
    lines += [f"warning: {note}" for note in result.notes]
    lines.append(f"model: {kept_parts(result)}")
    lines.append(result.consistency.text)
    return [
        *lines,
        *(f"warning: {warning}" for warning in (*result.warnings, *bodies_warnings(result))),
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
    return f"{text}; * parameters stay open" if is_open else text


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
    words = (f"{verdict_words(check)}{behind}", f"NOT CONFIRMED{behind}")
    return verdict(f"validation {check.source}", words, check.criteria, check.remarks)


def check_summary(checks: Sequence[Validation]) -> str:
    """Return a table of the joints and the verdict for each bag that a friction file was compared with."""
    lines = []
    for check in checks:
        torque = check.torque
        worst = zip(torque.worst, torque.worst_share, strict=True)
        values = zip(torque.names, torque.rms, torque.rms_share, worst, strict=True)
        rows = [
            (name, number(rms), number(share, ".2%"), number(most), number(of_most, ".2%"))
            for name, rms, share, (most, of_most) in values
        ]
        lines += table(("joint", "RMS, Nm", "of torque", "worst, Nm", "of largest"), rows)
        lines += [f"alarm: {alarm}" for alarm in check.alarms]
        lines += [f"warning: {note}" for note in check.notes]
        lines.append(validation_verdict(check))
    return in_unit("\n".join(lines), checks[0].torque.source.unit)


def friction_rows(result: Identification) -> dict[str, dict[str, ParameterEstimate]]:
    """Return the estimates of each element of which something is identified, in the order of tables."""
    return {
        name: row
        for name, row in _by_column(result).items()
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


def _by_column(result: Identification) -> dict[str, dict[str, ParameterEstimate]]:
    """Return the estimates of each element by the names of columns; both signs as one where they are equal."""
    rows = {}
    for element, identified in zip(result.arm.element_names, result.elements, strict=True):
        estimates = identified.estimates
        columns = {}
        for name in _REPORTED:
            if name in estimates:
                columns[name] = estimates[name]
            elif f"{name}_positive" in estimates:
                positive = estimates[f"{name}_positive"]
                negative = estimates[f"{name}_negative"]
                if positive == negative:
                    columns[name] = positive
                else:
                    columns |= {f"{name}+": positive, f"{name}-": negative}
        rows[element] = columns
    return rows


def lacking(result: Identification) -> list[tuple[str, str, str]]:
    """Return unidentified parameters, the elements that lack them for the same reason, and the reason."""
    without: dict[tuple[str, str], list[str]] = {}
    for element, columns in _by_column(result).items():
        for name, estimate in columns.items():
            if not estimate.identifiable:
                without.setdefault((name, estimate.reason), []).append(element)
    groups: dict[tuple[str, str], list[str]] = {}
    for (name, reason), whose in without.items():
        groups.setdefault((", ".join(whose), reason), []).append(name)
    return [(", ".join(group), whose, reason) for (whose, reason), group in groups.items()]
