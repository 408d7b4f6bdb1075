"""What is said of excitation runs: tables for the terminal, and the report, one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
from scipy.signal import welch

from rx90_common.base.arrays import Array
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, Band, Curve, Dots, Heat, Level, Panel, Plot
from rx90_emulator.identification.estimates import ParameterEstimate
from rx90_emulator.identification.excitation.friction.estimates import FrictionCurve
from rx90_emulator.identification.excitation.friction.law import Part
from rx90_emulator.identification.excitation.gains import PLAUSIBLE
from rx90_emulator.identification.excitation.instruments import remark
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.excitation.torques import (
    JointTorque,
    RunTorques,
    SpeedResiduals,
    TorqueValidation,
    misfits,
)
from rx90_emulator.identification.output.robot_files import torque_constants

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


_WINDOW_S = 60.0  # s of a run that are drawn: more would blur
_SPEED_BINS = 20
_MIN_BIN_SAMPLES = 8  # samples in a bin that is drawn
_RECORDED, _PREDICTED, _RESIDUAL = COLOURS[5], COLOURS[1], COLOURS[6]
_TIME, _SPEED = "time since the first motion, s", "velocity of the element, rad/s"


def torque_plot(run: RunTorques) -> Plot:
    """Show recorded and predicted torque and their difference, a panel for each joint."""
    moving = [joint.time for joint in run.joints if len(joint.time)]
    start = min(float(time[0]) for time in moving)
    panels = []
    for number, (name, joint) in enumerate(zip(run.names, run.joints, strict=True)):
        shown = _window(joint, start)
        time = shown.time - start
        curves = [
            Curve(time, shown.recorded, "measured", _RECORDED, 1.8),
            Curve(time, shown.predicted, "predicted", _PREDICTED, 0.8),
            Curve(time, shown.residual, "difference", _RESIDUAL, 0.6),
        ]
        panels.append(Panel(curves, name, _TIME if number == len(run.names) - 1 else "", "Nm"))
    return Plot(panels, height=1.7, share_x=True)


def _window(joint: JointTorque, start: float) -> JointTorque:
    """Return the first part of a series, with NaN where the joint stands still."""
    count = int(np.searchsorted(joint.time, start + _WINDOW_S))
    part = JointTorque(*(values[: max(1, count)] for values in joint))
    steps = np.diff(part.time)
    gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)
    return JointTorque(*(np.insert(values, gaps, np.nan) for values in part))


def spectra_plot(runs: Sequence[RunTorques]) -> Plot:
    """Show the amplitude spectra of measured torque and residual, a panel for each joint."""
    names, panels = runs[0].names, []
    for number, name in enumerate(names):
        joints = [run.joints[number] for run in runs]
        recorded, residual = _spectrum(joints, 2), _spectrum(joints, None)
        if recorded is None or residual is None:
            panels.append(Panel([], f"{name}: stands still"))
            continue
        curves = [
            Curve(*recorded, "measured", _RECORDED, 1.3),
            Curve(*residual, "difference", _PREDICTED, 0.9),
        ]
        below = "frequency, Hz" if number >= len(names) - 2 else ""
        panels.append(Panel(curves, name, below, "Nm/√Hz", "log", "log"))
    return Plot(panels, columns=2, height=1.9)


def _spectrum(joints: Sequence[JointTorque], column: int | None) -> tuple[Array, Array] | None:
    """Return frequencies, Hz, and the root of the mean spectral density of all runs; 0 where a joint stands still."""
    series = []
    step = min((float(np.median(np.diff(joint.time))) for joint in joints if len(joint.time) > 1), default=0.0)
    for joint in joints:
        if len(joint.time) > 1:
            place = np.rint((joint.time - joint.time[0]) / step).astype(np.intp)
            even = np.zeros(place[-1] + 1)
            even[place] = joint.residual if column is None else joint[column]
            series.append(even)
    if not series:
        return None
    length = min(max(map(len, series)), max(64, round(20.0 / step)))
    weights = [len(even) for even in series]
    found = [
        welch(even, 1.0 / step, nperseg=min(length, len(even)), nfft=length, detrend="constant") for even in series
    ]
    density = np.average([power for _, power in found], axis=0, weights=weights)
    return found[0][0][1:-1], np.sqrt(density[1:-1])


def speed_plot(speeds: Sequence[SpeedResiduals]) -> Plot:
    """Show the mean residual against the velocity of each element, with 95 % intervals."""
    panels = []
    for number, one in enumerate(speeds):
        marks: list[Level | Curve | Dots] = [Level(0.0, colour=_RESIDUAL)]
        if len(one.velocity):
            bars = 1.96 * np.nan_to_num(one.deviation)
            marks.append(Curve(one.velocity, one.residual, "", COLOURS[0], 0.9))
            marks.append(Dots(one.velocity, one.residual, "mean of a bin, 95 %", COLOURS[0], bars))
        panels.append(Panel(marks, one.element, _SPEED if number >= len(speeds) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=1.9)


def binned(velocity: Array, values: Array) -> Array:
    """Return for each bin of velocity its centre, the mean of the values, and their 10th and 90th percentile.

    Bins hold about the same number of samples, those of either sign apart.

    Args:
        velocity: rad/s, shape (k,).
        values: shape (k,).

    Returns:
        Shape (b, 4), sorted by velocity.
    """
    found = []
    for sign in (-1.0, 1.0):
        mine = np.flatnonzero(sign * velocity > 0.0)
        parts = np.array_split(mine[np.argsort(velocity[mine])], _SPEED_BINS // 2)
        for part in parts:
            if len(part) >= _MIN_BIN_SAMPLES:
                low, high = np.percentile(values[part], (10.0, 90.0))
                found.append((velocity[part].mean(), values[part].mean(), low, high))
    return np.array(found).reshape(-1, 4)


def time_plot(runs: Sequence[RunTorques], block: float) -> Plot:
    """Show the mean of the residual against the motion over blocks of time, each run with its colour."""
    names, panels = runs[0].names, []
    starts = [min((float(joint.time[0]) for joint in run.joints if len(joint.time)), default=0.0) for run in runs]
    for number, name in enumerate(names):
        marks: list[Level | Curve] = [Level(0.0, colour=_RESIDUAL)]
        for which, run in enumerate(runs):
            joint = run.joints[number]
            if not len(joint.time):
                continue
            place = ((joint.time - starts[which]) / block).astype(np.intp)
            count = np.bincount(place)
            used = np.flatnonzero(count)
            means = np.bincount(place, joint.residual * np.sign(joint.velocity))[used] / count[used]
            label = run.source.path.name if 1 < len(runs) <= len(COLOURS) else ""
            colour = COLOURS[which % len(COLOURS)]
            marks.append(
                Curve(np.asarray((used + 0.5) * block, dtype=np.float64), means, label, colour, 0.8, dots=True)
            )
        panels.append(Panel(marks, name, _TIME if number >= len(names) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=1.9)


def curve_plots(curves: Sequence[FrictionCurve], points: Sequence[Array]) -> Plot:
    """Show the friction torque of each element against its velocity with its band.

    Args:
        curves: of the elements.
        points: means of the measured torque for each element: velocity and torque, shape (b, 2); may be empty.
    """
    panels = []
    for number, (curve, measured) in enumerate(zip(curves, points, strict=True)):
        marks: list[Level | Band | Curve | Dots] = [
            Level(0.0, colour=_RESIDUAL),
            Level(0.0, colour=_RESIDUAL, upright=True),
        ]
        for sign in (-1.0, 1.0):
            side = sign * curve.velocity > 0.0
            low, high = (bound[side] for bound in curve.band)
            velocity = curve.velocity[side]
            marks.append(Band(velocity, low, high, "95 %", COLOURS[5]))
            marks.append(Curve(velocity, curve.torque[side], "identified", COLOURS[0], 1.2))
        if len(measured):
            marks.append(Dots(measured[:, 0], measured[:, 1], "measured", COLOURS[1]))
        panels.append(Panel(marks, curve.element, _SPEED if number >= len(curves) - 2 else "", "Nm"))
    return Plot(panels, columns=2, height=2.3)


def correlation_plot(names: Sequence[str], covariance: Array) -> Plot:
    """Show the correlation of all parameters as a heat map."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.isfinite(deviation) & (deviation > 0.0)
    labels = [name for name, one in zip(names, known.tolist(), strict=True) if one]
    matrix = covariance[np.ix_(known, known)] / np.outer(deviation[known], deviation[known])
    return Plot([Heat(labels, matrix)], height=7.0)


_MAX_CORRELATION = 0.95  # correlation from which two parameters are named


def excitation_page(
    result: ExcitationIdentification, date: datetime, versions: Mapping[str, str], files: Sequence[str]
) -> str:
    """Return the page's text.

    Args:
        result: what was identified.
        date: of the identification.
        versions: of interpreter and libraries.
        files: names of the robot's files, and last what is to be said about them.
    """
    names = result.problem.arm.element_names
    rows = [friction_columns(one.estimates) for one in result.elements]
    shown = list(dict.fromkeys(name for row in rows for name, one in row.items() if one.identifiable))
    checked = [one.torques for one in result.validations]
    longest = max(result.torques, key=lambda run: run.source.duration)
    curves = result.friction.curves()
    return render_page(
        "rx90_emulator.identification.output",
        "excitation.html.j2",
        result=result,
        date=date.strftime("%Y-%m-%d %H:%M UTC"),
        files=files,
        versions=", ".join(f"{name} {number}" for name, number in versions.items()),
        friction=list(zip(names, rows, strict=True)),
        shown=[(name, _unit(name)) for name in shown],
        kept=kept_parts(result),
        lacking=lacking(result),
        runs=[*(("fitted", run) for run in result.torques), *(("not used", run) for run in checked)],
        drawn=[(run, torque_plot(run)) for run in (checked[:2] or [longest])],
        curves=curve_plots(curves, _measured(result, curves)),
        spectra=spectra_plot(checked or result.torques),
        by_speed=speed_plot(result.speeds),
        misfits=misfits(result.speeds),
        closed_loop=remark(result.instruments),
        other="least squares" if result.instruments.biased else "instruments",
        gains=gain_rows(result),
        gain_warnings=gain_warnings(result),
        by_time=time_plot(result.torques, result.friction.blocks.length),
        correlation=correlation_plot(result.friction.names, result.friction.fit.covariance),
        close=_correlated_pairs(result.friction.names, result.friction.fit.covariance),
        runs_named=[run.source.path.name for run in checked or result.torques],
    )


def gain_rows(result: ExcitationIdentification) -> list[tuple[str, tuple[str, str] | None, str]]:
    """Return for each motor its name, gain with deviation if it was identified, and the torque constant if it has."""
    if result.gains is None:
        return []
    constants = torque_constants(result)
    names, count = result.problem.arm.names, len(result.gains.factor)
    written = [""] * count if constants is None else [f"{value:.4g}" for value in constants.value]
    pairs = zip(result.gains.factor.tolist(), result.gains.deviation.tolist(), strict=True)
    found = [ParameterEstimate(*pair).texts() if math.isfinite(pair[1]) else None for pair in pairs]
    return list(zip(names, found, written, strict=True))


def _unit(name: str) -> str:
    plain = name.rstrip("+-")
    return FRICTION_UNITS.get(plain) or FRICTION_UNITS.get(f"{plain}_positive", "")


def _measured(result: ExcitationIdentification, curves: Sequence[FrictionCurve]) -> list[Array]:
    """Return points beside the curve of each joint's own element: the curve and the residual, means in bins."""
    problem, friction = result.problem, result.friction
    residual = problem.torque - friction.predicted
    points = []
    for number, curve in enumerate(curves):
        rows = np.flatnonzero((problem.joint == number) & ~problem.reversal)
        bins = binned(problem.velocity[rows, number], residual[rows])
        low, high = (curve.velocity.min(), curve.velocity.max()) if len(curve.velocity) else (0.0, 0.0)
        bins = bins[(bins[:, 0] >= low) & (bins[:, 0] <= high)]
        torque = np.interp(bins[:, 0], curve.velocity, curve.torque) if len(bins) else np.empty(0)
        points.append(np.column_stack([bins[:, 0], torque + bins[:, 1]]))
    return points


def _correlated_pairs(names: Sequence[str], covariance: Array) -> list[tuple[str, str, float]]:
    """Return pairs of parameters that the runs hardly tell apart, the closest first."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(covariance / np.outer(deviation, deviation))
    pairs = [
        (names[i], names[j], float(correlation[i, j]))
        for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _MAX_CORRELATION, 1)), strict=True)
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:20]
