"""Terminal output of an identification, a check of a friction file and a measured run: tables and sentences.

Pages have the same sentences; `report` adds the plots.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TypeVar

from rx90_common.estimation.law import Part
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.estimates import IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import ExcitationIdentification, TorqueValidation
from rx90_emulator.identification.sanity import MovedBodies
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import verdict

_NEGATIVE = 3.0  # deviations below 0 from which a negative rotor inertia is significant
_CONFIRMED = ("confirmed", "NOT CONFIRMED")
_WITH_ALARM = ("confirmed, but the alarms stand", "NOT CONFIRMED")
_NONE: Mapping[str, FrictionElement] = MappingProxyType({})
_Value = TypeVar("_Value", bound=Hashable)


def _number(value: float, form: str = ".3f") -> str:
    """Return a number in a format; a dash for NaN, which means not compared."""
    return "-" if math.isnan(value) else f"{value:{form}}"


def _table(head: Sequence[str], places: Sequence[int], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first cells left-aligned, the others right-aligned at the columns `places`."""
    first, *others = places
    return [
        f"{name:<{first}}" + "".join(f"{cell:>{place}}" for cell, place in zip(cells, others, strict=False))
        for name, *cells in (head, *rows)
    ]


def _width(least: int, names: Iterable[str]) -> int:
    return max(least, *(len(name) + 1 for name in names))


def together(values: Iterable[tuple[str, _Value]]) -> list[tuple[str, _Value]]:
    """Return values with the names that have them, each value once."""
    names: dict[_Value, list[str]] = {}
    for name, value in values:
        names.setdefault(value, []).append(name)
    return [(", ".join(of), value) for value, of in names.items()]


def identification_summary(result: FrictionIdentification) -> str:
    """Return values with deviations, true values below, what is not identified with reasons, and the verdicts."""
    names = result.arm.element_names
    lines = _friction_lines(names, result.elements, result.truth)
    given = [name for name, identified in zip(names, result.elements, strict=True) if identified.given_bristles]
    if given:
        lines.append(f"bristles of {', '.join(given)}: as c0 those of {result.fallback_name}, assumed")
    sliding = result.sliding
    lines += [quality.text(name) for name, quality in zip(names, sliding.quality, strict=True) if quality]
    lines += [f"warning: {sliding.doubt}"] if sliding.doubt else []
    lines += [f"{use.bag.path}: {use.text(names)}" for use in sliding.usage]
    return "\n".join([*lines, *(validation_verdict(check, result.scope) for check in result.validations)])


def _friction_lines(
    names: Sequence[str], elements: Sequence[IdentifiedElement], truth: Mapping[str, FrictionElement] = _NONE
) -> list[str]:
    """Return the table of identified values, true ones below where they are known, and the reasons for the others."""
    shown = friction_rows(names, elements)
    columns = friction_columns(shown)
    rows = []
    for name, estimates in shown.items():
        rows.append([name, *(_with_deviation(estimates.get(column)) for column in columns)])
        if name in truth:
            rows.append(["  true", *(f"{true_value(truth[name], column):.6g}" for column in columns)])
    lines = _table(["element", *columns], [_width(10, names), *[22] * len(columns)], rows)
    nothing = [name for name in names if name not in shown]
    if nothing:
        lines.append(f"{', '.join(nothing)}: nothing identified")
    # Where elements have different reasons, the report gives them.
    lines += [
        f"not identified: {parameters} of {whose}: {reasons[0] if len(reasons) == 1 else 'reasons in the report'}"
        for parameters, whose, reasons in lacking(names, elements)
    ]
    return lines


def _with_deviation(estimate: ParameterEstimate | None) -> str:
    if estimate is None or not estimate.identifiable:
        return "-"
    value, deviation = estimate.texts()
    return f"{value} +- {deviation}" if estimate.deviation else value


def validation_verdict(check: Validation, scope: str = "") -> str:
    """Return the verdict of a bag on a friction file, with the decisive joints, values and limits."""
    *torque, tip = check.criteria
    tips = (tip, f"RMS {check.tip_rms * 1e6:.2f} µm") if len(check.tip_distance) else ("no set-points, so no tip path",)
    behind = f" by a bag that the fit did not use; {scope}" if scope else ""
    confirmed = _WITH_ALARM if check.alarms else _CONFIRMED
    words = (confirmed[0] + behind, confirmed[1] + behind)
    return verdict(f"validation {check.source}", words, *torque, *check.remarks, *tips)


def check_summary(checks: Sequence[Validation]) -> str:
    """Return a table of the joints and the verdict for each bag that a friction file was compared with."""
    lines = []
    for check in checks:
        values = zip(check.names, check.rms, check.rms_share, check.worst, check.worst_share, strict=True)
        rows = ((name, _number(a), _number(b, ".2%"), _number(c), _number(d, ".2%")) for name, a, b, c, d in values)
        head = ("joint", "RMS, Nm", "of torque", "worst, Nm", "of largest")
        lines += _table(head, (_width(8, check.names), 10, 11, 11, 12), rows)
        lines += [f"alarm: {alarm}" for alarm in check.alarms]
        lines += [f"recording: {text}" for text in check.notes]
        lines.append(validation_verdict(check))
    return in_unit("\n".join(lines), checks[0].unit)


def measured_facts(result: MeasuredComparison) -> tuple[str, ...]:
    """Return what was simulated and how it was compared, a sentence each."""
    saturated = zip(result.names, result.saturated, strict=True)
    return (
        f"set-points: {result.setpoints}",
        f"torques and positions are compared below {result.bandwidths.torque:.3g} Hz ({result.bandwidths.reason})",
        f"the simulated motion is {abs(result.lag) * 1e3:.3f} ms {'later' if result.lag >= 0.0 else 'earlier'}, which "
        "is taken out",
        *(f"tip, {what}: {path.words}" for what, path in zip(("measured", "simulated"), result.paths, strict=True)),
        *(f"{name}'s motor is at its limit in {share:.1%} of the simulated time" for name, share in saturated if share),
        *result.remarks,
    )


def measured_verdict(result: MeasuredComparison) -> str:
    """Return the verdict, with the decisive values and their limits."""
    return verdict(result.source.path, ("agrees", "DOES NOT AGREE"), *result.criteria)


def measured_summary(result: MeasuredComparison) -> str:
    """Return set-points, filters and lag, a row for each joint, and the verdict."""
    torque = result.torque
    head = "joint", "torque RMS", "of measured", "worst", "of largest", "compared", "position RMS", "worst"
    rows = [
        (name, f"{_number(torque.rms[k])} Nm", _number(torque.rms_share[k], ".2%"),
         f"{_number(torque.worst[k])} Nm", _number(torque.worst_share[k], ".2%"),
         f"{result.compared_share[k]:.0%}",
         f"{1e3 * result.position_rms[k]:.3f} mrad", f"{1e3 * result.position_worst[k]:.3f} mrad")
        for k, name in enumerate(result.names)
    ]  # fmt: skip
    table = _table(head, (_width(8, result.names), 12, 13, 11, 12, 10, 15, 12), rows)
    return "\n".join([*measured_facts(result), *table, measured_verdict(result)])


def excitation_summary(result: ExcitationIdentification) -> str:
    """Return friction with deviations, goodness of fit, the selected model, and what was left out and why."""
    joints = result.torques[0].names
    lines = _friction_lines(result.problem.arm.element_names, result.elements)
    if followed := ", ".join(result.robot.followed):
        lines.append(f"not identified, along their recorded motion: {followed}")
    if unknown := ", ".join(result.undetermined):
        lines.append(f"not determined by these runs: {unknown}; the files take them from the description")
    runs = [("fitted", run) for run in result.torques]
    for check in result.validations:
        runs += [("unseen", check.torques), ("simplest", check.simplest), ("files", check.files)]
    fits = []
    for use, run in runs:
        fits.append([f"{use} {run.source.path.name}", *(_number(v, ".1%") for v in (*run.share, run.total_share))])
    width = max(8, *(len(run.source.path.name) + 9 for _, run in runs))
    places = [max(10, len(n) + 2) for n in joints]
    lines += _table(["torque RMS", *joints, "all"], [width, *places, 8], fits)
    lines += _bodies_table(result.bodies)
    lines += [f"alarm: {alarm}" for alarm in result.alarms]
    bandwidths = result.problem.runs[0].bandwidths
    lines.append(f"low-pass: {bandwidths.position:.3g} Hz, torques {bandwidths.torque:.3g} Hz: {bandwidths.reason}")
    lines += [note if note.startswith("warning") else f"recording: {note}" for note in result.notes]
    lines.append(f"model: {kept_parts(result)}")
    lines += filter(None, (result.consistency.text, result.consistency.open_text))
    lines += [f"warning: {warning}" for warning in (*result.warnings, *bodies_warnings(result))]
    for check in result.validations:
        far = f"bodies {result.consistency.inertias.distance:.2g} standard deviations from the base parameters"
        lines.append(unseen_verdict(check, far, alarms=result.alarms))
    return in_unit("\n".join([*in_currents(result), *lines]), result.unit)


def in_currents(result: ExcitationIdentification) -> list[str]:
    """Return a warning if torques are currents, which a simulation must not use as torques; else nothing."""
    if result.unit == "Nm":
        return []
    return [f"warning: efforts in {result.unit} and no torque constants: friction, inertias and the files are in that "
            "scale, and no simulation should load them"]  # fmt: skip


def unseen_verdict(check: TorqueValidation, *said: str, alarms: Sequence[str] = ()) -> str:
    """Return the verdict of an unseen run on the result of excitation runs, as `validation_verdict` does."""
    words = _WITH_ALARM if alarms else _CONFIRMED
    return verdict(f"validation {check.torques.source.path}", words, *check.criteria, *check.remarks, *said)


def _bodies_table(bodies: Sequence[MovedBodies]) -> list[str]:
    """Return what joints move by the description and by the files."""
    rows = [
        (moved.joint, *(f"{before:.3g} / {after:.3g}" for before, after in (moved.mass, moved.moment, moved.inertia)))
        for moved in bodies
    ]
    head = ("moved: described / files", "mass, kg", "first moment, kg m", "inertia, kg m^2")
    return _table(head, (26, 20, 20, 20), rows)


def kept_parts(result: ExcitationIdentification) -> str:
    """Return in words the parts of the selected friction, and which elements have them."""
    names = result.problem.arm.element_names
    texts = ["Coulomb + viscous"]
    for part in Part:
        having = [name for name, own in zip(names, result.fitted.laws, strict=True) if part in own.parts]
        if having:
            texts.append(f"{part.value}: {'all' if len(having) == len(names) else ', '.join(having)}")
    return " + ".join(texts)


def bodies_warnings(result: ExcitationIdentification) -> list[str]:
    """Return whether the bodies in the files are far from the base parameters, and which rotors are below 0."""
    found = [result.consistency.warning] if result.consistency.warning else []
    rotors = {f"Ia_{k}": name for k, name in enumerate(result.problem.arm.names, 1)}
    below = [
        f"{rotors[one.group]} {' +- '.join(one.estimate.texts())} kg m^2"
        for one in result.base
        if one.group in rotors
        and one.estimate.identifiable
        and one.estimate.value < -_NEGATIVE * one.estimate.deviation
    ]
    if below:
        found.append(
            f"rotor inertias came out below 0: {', '.join(below)}; torques of sensors between gear and link hold no "
            "rotors (--no-rotors)"
        )
    return found


_REPORTED = ("tau_c", "c2", "alpha", "tau_s", "omega_s", "delta", "c0", "c1")


def friction_rows(
    names: Sequence[str], elements: Sequence[IdentifiedElement]
) -> dict[str, dict[str, ParameterEstimate]]:
    """Return the estimates of each element of which something is identified, in the order of tables."""
    rows = {name: _by_column(identified) for name, identified in zip(names, elements, strict=True)}
    return {name: row for name, row in rows.items() if any(estimate.identifiable for estimate in row.values())}


def friction_columns(rows: Mapping[str, Mapping[str, ParameterEstimate]]) -> list[str]:
    """Return the parameters that are identified of any element."""
    known = {column for row in rows.values() for column, estimate in row.items() if estimate.identifiable}
    return [column for name in _REPORTED for column in (name, f"{name}+", f"{name}-") if column in known]


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
            unknown = not positive.identifiable and not negative.identifiable and positive.reason == negative.reason
            if unknown or positive == negative:
                columns[name] = positive
            else:
                columns |= {f"{name}+": positive, f"{name}-": negative}
    return columns


def lacking(names: Sequence[str], elements: Sequence[IdentifiedElement]) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return unidentified parameters with their elements and reasons, grouped by elements."""
    reasons: dict[str, tuple[tuple[str, str], ...]] = {}  # by parameter: elements with the reasons
    for element, identified in zip(names, elements, strict=True):
        for name, estimate in _by_column(identified).items():
            if not estimate.identifiable:
                reasons[name] = (*reasons.get(name, ()), (element, estimate.reason))
    groups = []
    for parameters, of in together(reasons.items()):
        whose = "all elements" if len(of) == len(names) else ", ".join(element for element, _ in of)
        pairs = together(of)
        texts = [reason if len(pairs) == 1 else f"{some}: {reason}" for some, reason in pairs]
        groups.append((parameters, whose, tuple(texts)))
    return groups
