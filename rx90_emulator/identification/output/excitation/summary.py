"""The result of excitation runs as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rx90_emulator.identification.excitation.friction.law import Part
from rx90_emulator.identification.excitation.gains import PLAUSIBLE
from rx90_emulator.identification.excitation.instruments import remark
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.excitation.torques import TorqueValidation, misfits
from rx90_emulator.identification.model.estimates import ParameterEstimate

_SHOWN = ("tau_c", "c2", "alpha", "tau_s", "omega_s", "delta", "c0", "c1", "load.driving", "load.driven")


def excitation_summary(result: ExcitationIdentification) -> str:
    """Return friction with deviations, goodness of fit, the model that was kept, and what was left out and why."""
    parts = [
        _friction(result),
        *_lacking(result),
        *undetermined_texts(result),
        *_fits(result),
        *([result.zeros.text] if result.zeros.text else []),
        f"model: {kept_parts(result)}; last step of the choice: {result.model.reason}",
        f"closed loop: {remark(result.instruments)}",
        *gain_texts(result),
        *([] if result.loads is None else [result.loads.remark(result.problem.arm.element_names)]),
        *(f"misfit: {text}" for text in misfits(result.speeds)),
        *(f"drift: {one.text}" for one in result.trends),
        *(_verdict(check) for check in result.validations),
    ]
    return "\n".join(parts)


def kept_parts(result: ExcitationIdentification) -> str:
    """Return in words what the friction that was kept consists of, and which elements have it."""
    names, parts = result.problem.arm.element_names, result.friction.parts
    texts = ["Coulomb + viscous"]
    for part in Part:
        having = [name for name, own in zip(names, parts, strict=True) if part in own]
        if having:
            texts.append(f"{part.value}: {'all' if len(having) == len(names) else ', '.join(having)}")
    return " + ".join(texts)


def gain_texts(result: ExcitationIdentification) -> list[str]:
    """Return by what the recorded torque of each motor is multiplied, if that was identified, and what it leaves."""
    if result.gains is None:
        return []
    gains, names = result.gains, result.problem.arm.names
    texts = [
        f"{name} {' +- '.join(ParameterEstimate(value, deviation).texts())}" if math.isfinite(deviation)
        else f"{name} 1 (the payload does not tell it)"
        for name, value, deviation in zip(names, gains.factor.tolist(), gains.deviation.tolist(), strict=True)
    ]  # fmt: skip
    lines = [
        f"drive gains, true over recorded torque: {', '.join(texts)}; all values are for torques multiplied by them"
    ]
    return lines + [f"warning: {text}" for text in gain_warnings(result)]


def gain_warnings(result: ExcitationIdentification) -> list[str]:
    """Return which drive gains are hardly to be believed, and which motors keep theirs, and what follows."""
    if result.gains is None:
        return []
    gains, names = result.gains, result.problem.arm.names
    lines = []
    if len(gains.implausible):
        values = ", ".join(f"{names[k]} {gains.factor[k]:.3g}" for k in gains.implausible)
        lines.append(
            f"hardly a drive gain: {values}; torque constants, hot magnets and gears explain {PLAUSIBLE[0]:g} to "
            f"{PLAUSIBLE[1]:g}. Is the payload's mass or centre, the run that carried it, a gear or the unit of effort "
            "another one (A RMS for peak A: 0.71 or 1.41)? Inertias, friction and torque constants are as much off then"
        )
    kept = [name for k, name in enumerate(names) if k not in gains.told]
    if kept:
        lines.append(
            f"{', '.join(kept)} keep{'s' if len(kept) == 1 else ''} the given gain, whose scale may not fit "
            "that of the identified ones: inertias, which all joints share, and torques there can be off by as much"
        )
    return lines


def undetermined_texts(result: ExcitationIdentification) -> list[str]:
    """Return in a line which base parameters the runs leave open, if any."""
    if not result.undetermined:
        return []
    return [f"not determined by these runs: {', '.join(result.undetermined)}; the files take them from the description"]


def friction_columns(estimates: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """Return estimates of an element in the order in which tables show them; both signs as one where they are equal."""
    found = {}
    for name in _SHOWN:
        if name in estimates:
            found[name] = estimates[name]
        elif f"{name}_positive" in estimates:
            positive, negative = (estimates[f"{name}_{sign}"] for sign in ("positive", "negative"))
            if _same(positive, negative):
                found[name] = positive
            else:
                found |= {f"{name}+": positive, f"{name}-": negative}
    return found


def _same(a: ParameterEstimate, b: ParameterEstimate) -> bool:
    return (a.identifiable, a.reason) == (b.identifiable, b.reason) and (
        not a.identifiable or (a.value, a.deviation) == (b.value, b.deviation)
    )


def _friction(result: ExcitationIdentification) -> str:
    rows = [friction_columns(one.estimates) for one in result.elements]
    columns = [name for name in dict.fromkeys(name for row in rows for name in row)
               if any(name in row and row[name].identifiable for row in rows)]  # fmt: skip
    names = result.problem.arm.element_names
    width = max(9, *(len(name) + 1 for name in names))
    lines = [f"{'element':<{width}}" + "".join(f"{name:>22}" for name in columns)]
    for name, row in zip(names, rows, strict=True):
        cells = (_cell(row[c]) if c in row and row[c].identifiable else "-" for c in columns)
        lines.append(f"{name:<{width}}" + "".join(f"{cell:>22}" for cell in cells))
    return "\n".join(lines)


def _cell(estimate: ParameterEstimate) -> str:
    value, deviation = estimate.texts()
    return f"{value} +- {deviation}" if estimate.deviation else value


def lacking(result: ExcitationIdentification) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return what is not identified: parameters, elements, and the reasons; what the same elements lack together."""
    names = result.problem.arm.element_names
    reasons: dict[str, dict[str, str]] = {}
    for element, one in zip(names, result.elements, strict=True):
        for name, estimate in friction_columns(one.estimates).items():
            if not estimate.identifiable:
                reasons.setdefault(name, {})[element] = estimate.reason
    together: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for name, of in reasons.items():
        together.setdefault(tuple(of.items()), []).append(name)
    return [
        (
            ", ".join(parameters),
            "all elements" if len(of) == len(names) else ", ".join(element for element, _ in of),
            _reasons(of),
        )
        for of, parameters in together.items()
    ]


def _reasons(of: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """Return the reasons, each with its elements where they differ."""
    elements: dict[str, list[str]] = {}
    for element, reason in of:
        elements.setdefault(reason, []).append(element)
    if len(elements) == 1:
        return tuple(elements)
    return tuple(f"{', '.join(names)}: {reason}" for reason, names in elements.items())


def _lacking(result: ExcitationIdentification) -> list[str]:
    """Return a line for each reason; where elements have different ones, the report gives them."""
    return [
        f"not identified: {parameters} of {elements}: {reasons[0] if len(reasons) == 1 else 'reasons in the report'}"
        for parameters, elements, reasons in lacking(result)
    ]


def _fits(result: ExcitationIdentification) -> list[str]:
    """Return a row for each run: RMS difference over RMS torque of each joint and of all, and chi^2."""
    names = result.problem.arm.names
    runs = [*(("fitted", run) for run in result.torques), *(("unseen", one.torques) for one in result.validations)]
    width = max(8, *(len(run.source.path.name) + 9 for _, run in runs))
    columns = [max(10, len(name) + 2) for name in names]
    head = (
        f"{'torque RMS':<{width}}" + "".join(f"{n:>{w}}" for n, w in zip(names, columns, strict=True)) + f"{'all':>8}"
    )
    lines = [head]
    for use, run in runs:
        cells = "".join(f"{_percent(v):>{w}}" for v, w in zip(run.share, columns, strict=True))
        lines.append(f"{use + ' ' + run.source.path.name:<{width}}{cells}{_percent(run.total_share):>8}")
        shown = (">1e4" if k else _number(v) for k, v in zip(run.noiseless, run.chi_square, strict=True))
        chi = "".join(f"{cell:>{w}}" for cell, w in zip(shown, columns, strict=True))
        lines.append(f"{'  chi^2 over noise':<{width}}{chi}")
        if run.noiseless.any():
            lines.append("  (>1e4: next to no noise beside the difference, as in smoothed torques; tells nothing)")
    return lines


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1%}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def _verdict(check: TorqueValidation) -> str:
    limits, run = check.tolerances, check.torques
    worst = max(zip(run.share, run.names, strict=True), key=lambda pair: -1.0 if math.isnan(pair[0]) else pair[0])
    return (
        f"validation {run.source.path}: {'confirmed' if check.passed else 'NOT CONFIRMED'}: torque RMS of all joints "
        f"{run.total_share:.1%} (limit {limits.total:.0%}), largest {worst[0]:.1%} ({worst[1]}, "
        f"limit {limits.joint:.0%})"
    )
