"""The pages of an identification from sweeps or excitation runs, a check of a friction file and a measured run.

A report is one self-contained HTML page. Tables and sentences are in the templates, which share `_macros.html.j2`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import welch

from rx90_common.base.arrays import Array
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Band, Curve, Dots, Heat, Level, Mark, Panel, Plot, Scale
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.output import summary
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.sliding.quality import CurvePoints
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import JointTorque, RunTorques

_DRAWN_S = 60.0  # s of a run in a plot: more could not be resolved
_RECORDED = COLOURS[5]
_PREDICTED = COLOURS[1]
_DIFFERENCE = COLOURS[6]
_TIME = "time since the first motion, s"
_SPEED = "velocity of the element, rad/s"
_INTERVAL = 1.96  # standard deviations, 95 %
_DRAWN_SHARE = 20  # one of so many parts of a micro-oscillation is drawn: more loops would cover each other
_ACROSS = 2  # columns of plots with a panel for each joint


def _render(template: str, date: datetime | None = None, unit: str = "Nm", **values: Any) -> str:
    """Return a page on torques in a unit; templates can use the functions of `summary`, and `values`."""
    day = (date or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC")
    return render_page(
        "rx90_emulator.identification.output",
        template,
        partial(in_unit, unit=unit),
        date=day,
        summary=summary,
        zip=zip,
        **values,
    )


def _compared(
    name: str,
    time: Array,
    both: Mapping[str, Array],
    unit: str = "Nm",
    below: str = "",
    difference: Array | None = None,
) -> Panel:
    """Return a panel of a recorded and a predicted quantity by their labels, and of their difference where given."""
    pairs = zip(both.items(), (_RECORDED, _PREDICTED), (1.8, 0.8), strict=True)
    curves = [Curve(time, values, label, colour, width) for (label, values), colour, width in pairs]
    if difference is not None:
        curves.append(Curve(time, difference, "difference", _DIFFERENCE, 0.6))
    return Panel(curves, name, below, unit)


def _grid(
    marks: Mapping[str, Sequence[Mark]], x_label: str, y_label: str = "Nm", scale: Scale = "linear", height: float = 1.9
) -> Plot:
    """Return a plot with a panel for each name, two in a row."""
    last = len(marks) - _ACROSS
    panels = [
        Panel(some, name, x_label if k >= last else "", y_label, scale, "log" if scale == "log" else "linear")
        for k, (name, some) in enumerate(marks.items())
    ]
    return Plot(panels, columns=_ACROSS, height=height)


def _checks(checks: Sequence[Validation]) -> list[tuple[Validation, str, Plot]]:
    """Return validations with the names of their bags, and torques and distance of the tips along each."""
    found = []
    for check in checks:
        torque = check.torque
        tips = len(check.tip_distance) > 0
        rows = zip(check.names, torque.recorded.T, torque.predicted.T, torque.difference.T, strict=True)
        panels = [
            _compared(name, torque.time, {"recorded": recorded, "predicted": predicted}, "Nm",
                      "" if tips or name != check.names[-1] else "time, s", residual)
            for name, recorded, predicted, residual in rows
        ]  # fmt: skip
        if tips:
            far = Curve(check.tip_time, check.tip_distance * 1e6, "", COLOURS[0], 0.8)
            panels.append(Panel([far], "tips", "time, s", "distance, µm"))
        found.append((check, Path(check.source).name, Plot(panels, height=1.6, share_x=True)))
    return found


def check_page(checks: Sequence[Validation], friction_file: str) -> str:
    """Return the text of the page on the comparison of a friction file with bags.

    Args:
        checks: one for each bag.
        friction_file: name of the file.
    """
    unit = checks[0].unit
    return _render("friction_check.html.j2", unit=unit, checks=_checks(checks), friction_file=friction_file)


def measured_page(result: MeasuredComparison, files: tuple[str, ...]) -> str:
    """Return the text of the page on a measured run.

    Args:
        result: of the comparison.
        files: that the robot was read from.
    """
    time = result.time - result.time[0]
    torque = result.agreement
    shown = slice(0, int(np.searchsorted(time, _DRAWN_S, side="right")))
    torques = []
    positions = []
    for k, name in enumerate(result.names):
        below = "time since the comparison began, s" if name == result.names[-1] else ""
        both = {"measured": torque.recorded[shown, k], "simulated": torque.predicted[shown, k]}
        torques.append(_compared(name, time[shown], both, "Nm", below, torque.difference[shown, k]))
        both = {"measured": result.position[shown, k], "simulated": result.simulated_position[shown, k]}
        positions.append(_compared(name, time[shown], both, "rad", below))
        difference = 1e3 * (both["simulated"] - both["measured"])
        positions.append(
            Panel([Curve(time[shown], difference, "simulated - measured", _DIFFERENCE, 0.7)], name, below, "mrad")
        )
    return _render(
        "measured.html.j2",
        result=result,
        files=files,
        torques=Plot(torques, height=1.7, share_x=True),
        positions=Plot(positions, columns=2, height=1.7, share_x=True),
    )


def report_page(result: FrictionIdentification, friction_file: str) -> str:
    """Return the text of the page on an identification from sweeps and micro-oscillations.

    Args:
        result: the identification.
        friction_file: name of the file with the values.
    """
    names = result.arm.element_names
    sliding = result.sliding
    presliding = result.presliding
    named = dict(zip(names, result.elements, strict=True))
    curves = [(name, curve) for name, curve in zip(names, sliding.curves, strict=True) if len(curve.velocity)]
    return _render(
        "identification.html.j2",
        result=result,
        named=named,
        identified=[(name, named[name]) for name in result.identified_elements],
        others=[name for name in names if name not in result.identified_elements],
        assumed=[(summary.which(lacking), reason) for reason, lacking in result.unidentifiable.items()],
        units=FRICTION_UNITS,
        fading=[(name, one.element.omega_d) for name, one in named.items() if math.isfinite(one.element.omega_d)],
        shared=names[len(result.arm.names) :],
        checks=_checks(result.validations),
        friction_file=friction_file,
        curves=[_curve_plot(name, curve) for name, curve in curves],
        trends=[Plot([Panel(
            (Level(0.0), Dots(curve.time, np.sign(curve.velocity) * (curve.torque - curve.fitted))),
            name, "time in the series, s", "residual, Nm",
        )], height=1.8) for name, curve in curves],
        loops=[_loop_plot(joint, *loop) for joint, loop in presliding.loops.items()],
        correlations=_correlation_plots(result),
    )  # fmt: skip


def _curve_plot(name: str, curve: CurvePoints) -> Plot:
    """Show torque against velocity of an element, with the residuals below."""
    above: list[Mark] = [Level(0.0, upright=True), Dots(curve.velocity, curve.torque, "measured, one stretch each")]
    below: list[Mark] = [Level(0.0, upright=True), Level(0.0)]
    for side in (curve.line[0] < 0.0, curve.line[0] > 0.0):
        velocity, torque, deviation = curve.line[:, side]
        above.append(Curve(velocity, torque, "identified", INK, 0.9))
        far = _INTERVAL * deviation
        below.append(Band(velocity, -far, far, "95 % of the identified curve", GREY))
    label = "measured - identified, 95 % of the noise"
    bars = _INTERVAL * curve.deviation
    below.append(Dots(curve.velocity, curve.torque - curve.fitted, label, COLOURS[0], bars))
    speeds = "velocity of the element, rad/s (logarithmic on either side)"
    smallest = float(np.abs(curve.velocity).min())
    panels = [
        Panel(above, name, "", "friction torque, Nm", "symlog", smallest=smallest),
        Panel(below, "", speeds, "residual, Nm", "symlog", smallest=smallest),
    ]
    return Plot(panels, height=2.3)


def _loop_plot(name: str, position: Array, torques: Mapping[str, Array]) -> Plot:
    """Show torques against position in the middle of a micro-motion: measured and simulated."""
    count = len(position)
    part = slice((_DRAWN_SHARE - 1) * count // (2 * _DRAWN_SHARE), (_DRAWN_SHARE + 1) * count // (2 * _DRAWN_SHARE))
    curves = [
        Curve(position[part] * 1e6, torque[part], of, colour, 1.8 if of == "measured" else 0.8)
        for (of, torque), colour in zip(torques.items(), (_RECORDED, _PREDICTED), strict=True)
    ]
    return Plot([Panel(curves, name, "position, µrad", "friction torque, Nm")], height=3.2)


def _correlation_plots(result: FrictionIdentification) -> list[Plot]:
    """Return the correlation of each element's parameters."""
    plots = []
    pairs = zip(result.arm.element_names, result.sliding.estimates, result.presliding.estimates, strict=True)
    for name, sliding, presliding in pairs:
        names = (*sliding.parameters, *presliding.parameters)
        first = len(sliding.parameters)
        matrix = np.full((len(names), len(names)), np.nan)
        matrix[:first, :first] = sliding.correlation
        matrix[first:, first:] = presliding.correlation
        if np.isfinite(matrix).any():
            plots.append(Plot([Heat(names, matrix, name)]))
    return plots


_MAX_CORRELATION = 0.95  # correlation from which two parameters are listed
_SPEED_BINS = 20
_MIN_BIN_SAMPLES = 8  # least number of samples in a bin


def excitation_page(
    result: ExcitationIdentification, date: datetime, versions: Mapping[str, str], files: Sequence[str]
) -> str:
    """Return the text of the page on an identification from excitation runs.

    Args:
        result: the identification.
        date: of the identification.
        versions: of interpreter and libraries.
        files: names of the robot's files, and last a sentence about them.
    """
    friction = result.friction
    rows = [summary.friction_columns(one.estimates) for one in result.elements]
    shown = dict.fromkeys(name for row in rows for name, one in row.items() if one.identifiable)
    units = {name: FRICTION_UNITS.get(plain) or FRICTION_UNITS.get(f"{plain}_positive", "")
             for name in shown if (plain := name.rstrip("+-"))}  # fmt: skip
    checked = [one.torques for one in result.validations]
    longest = max(result.torques, key=lambda run: run.source.duration)
    deviation = np.sqrt(np.maximum(np.diag(friction.fit.covariance), 0.0))
    known = np.flatnonzero(np.isfinite(deviation) & (deviation > 0.0))
    names = [friction.names[k] for k in known.tolist()]
    correlation = friction.fit.covariance[np.ix_(known, known)] / np.outer(deviation[known], deviation[known])
    close = [(names[i], names[j], float(correlation[i, j]))
             for i, j in np.argwhere(np.triu(np.abs(correlation) > _MAX_CORRELATION, 1))]  # fmt: skip
    return _render(
        "excitation.html.j2",
        date,
        result.unit,
        result=result,
        files=files,
        versions=", ".join(f"{name} {number}" for name, number in versions.items()),
        friction=list(zip(result.problem.arm.element_names, rows, strict=True)),
        shown=list(units.items()),
        runs=[*(("fitted", run) for run in result.torques), *(("not used", run) for run in checked)],
        drawn=[(run, _run_plot(run)) for run in (checked[:2] or [longest])],
        curves=_friction_plot(result),
        spectra=_spectra_plot(checked or result.torques),
        by_speed=_speed_plot(result),
        by_time=_time_plot(result.torques, friction.blocks.length),
        correlation=Plot([Heat(names, correlation)], height=7.0),
        close=sorted(close, key=lambda pair: -abs(pair[2]))[:20],
        runs_named=[run.source.path.name for run in checked or result.torques],
    )


def _start(run: RunTorques) -> float:
    return min((float(joint.time[0]) for joint in run.joints if len(joint.time)), default=0.0)


def _run_plot(run: RunTorques) -> Plot:
    """Show the torques of the first part of a run, with gaps where a joint stands still."""
    panels = []
    for name, joint in zip(run.names, run.joints, strict=True):
        count = max(1, int(np.searchsorted(joint.time, _start(run) + _DRAWN_S)))
        time, _, recorded, predicted = (values[:count] for values in joint)
        steps = np.diff(time)
        gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)
        rows = (time - _start(run), recorded, predicted, recorded - predicted)
        time, recorded, predicted, residual = (np.insert(values, gaps, np.nan) for values in rows)
        below = _TIME if name == run.names[-1] else ""
        panels.append(_compared(name, time, {"measured": recorded, "predicted": predicted}, "Nm", below, residual))
    return Plot(panels, height=1.7, share_x=True)


def _spectra_plot(runs: Sequence[RunTorques]) -> Plot:
    """Show the amplitude spectra of measured torque and residual, a panel for each joint."""
    marks: dict[str, list[Mark]] = {}
    for number, name in enumerate(runs[0].names):
        joints = [run.joints[number] for run in runs if len(run.joints[number].time) > 1]
        marks[name if joints else f"{name}: stands still"] = [
            Curve(*_spectrum(joints, [getattr(joint, of) for joint in joints]), label, colour, width)
            for of, label, colour, width in (
                ("recorded", "measured", _RECORDED, 1.3), ("residual", "difference", _PREDICTED, 0.9)
            ) if joints
        ]  # fmt: skip
    return _grid(marks, "frequency, Hz", "Nm/√Hz", "log")


def _spectrum(joints: Sequence[JointTorque], values: Sequence[Array]) -> tuple[Array, Array]:
    """Return frequencies, Hz, and the root of the mean spectral density of all runs; 0 where a joint stands still."""
    series = []
    step = min(float(np.median(np.diff(joint.time))) for joint in joints)
    for joint, own in zip(joints, values, strict=True):
        place = np.rint((joint.time - joint.time[0]) / step).astype(np.intp)
        even = np.zeros(place[-1] + 1)
        even[place] = own
        series.append(even)
    weights = [len(even) for even in series]
    length = min(max(weights), max(64, round(20.0 / step)))
    found = [
        welch(even, 1.0 / step, nperseg=min(length, len(even)), nfft=length, detrend="constant") for even in series
    ]
    density = np.average([power for _, power in found], axis=0, weights=weights)
    return found[0][0][1:-1], np.sqrt(density[1:-1])


def _speed_plot(result: ExcitationIdentification) -> Plot:
    """Show the mean residual against the velocity of each element, with 95 % intervals."""
    marks: dict[str, list[Mark]] = {}
    for one in result.speeds:
        marks[one.element] = [Level(0.0, colour=_DIFFERENCE)]
        if len(one.velocity):
            bars = _INTERVAL * np.nan_to_num(one.deviation)
            marks[one.element].append(Curve(one.velocity, one.residual, "", COLOURS[0], 0.9))
            marks[one.element].append(Dots(one.velocity, one.residual, "mean of a bin, 95 %", COLOURS[0], bars))
    return _grid(marks, _SPEED)


def _time_plot(runs: Sequence[RunTorques], block: float) -> Plot:
    """Show the mean of the residual against the motion over blocks of time, each run with its colour."""
    marks: dict[str, list[Mark]] = {name: [Level(0.0, colour=_DIFFERENCE)] for name in runs[0].names}
    for which, run in enumerate(runs):
        label = run.source.path.name if 1 < len(runs) <= len(COLOURS) else ""
        colour = COLOURS[which % len(COLOURS)]
        for own, joint in zip(marks.values(), run.joints, strict=True):
            if len(joint.time):
                place = ((joint.time - _start(run)) / block).astype(np.intp)
                count = np.bincount(place)
                used = np.flatnonzero(count)
                means = np.bincount(place, joint.residual * np.sign(joint.velocity))[used] / count[used]
                middle: Array = np.asarray((used + 0.5) * block, dtype=np.float64)
                own.append(Curve(middle, means, label, colour, 0.8, dots=True))
    return _grid(marks, _TIME)


def _friction_plot(result: ExcitationIdentification) -> Plot:
    """Show the friction torque of each element against its velocity, its band, and means of the measured torque.

    The means belong to the joint's own element: its curve plus the mean residual, in bins of each sign with about the
    same number of samples.
    """
    problem = result.problem
    marks = {}
    residual = problem.torque - result.friction.predicted
    joints = np.flatnonzero(problem.arm.identified)
    for number, curve in enumerate(result.friction.curves()):
        own: list[Mark] = [Level(0.0, colour=_DIFFERENCE), Level(0.0, colour=_DIFFERENCE, upright=True)]
        has_own_joint = number < len(joints)  # a coupled element has no joint of its own
        rows = np.flatnonzero((problem.joint == joints[number]) & ~problem.reversal) if has_own_joint else joints[:0]
        velocity = problem.velocity[rows, number]
        residual_torque = residual[rows]
        low, high = (curve.velocity.min(), curve.velocity.max()) if len(curve.velocity) else (0.0, 0.0)
        points = []
        for sign in (-1.0, 1.0):
            side = sign * curve.velocity > 0.0
            low_side, high_side = (bound[side] for bound in curve.band)
            own.append(Band(curve.velocity[side], low_side, high_side, "95 %", COLOURS[5]))
            own.append(Curve(curve.velocity[side], curve.torque[side], "identified", COLOURS[0], 1.2))
            one_sign = np.flatnonzero(sign * velocity > 0.0)
            for part in np.array_split(one_sign[np.argsort(velocity[one_sign])], _SPEED_BINS // 2):
                if len(part) >= _MIN_BIN_SAMPLES and low <= (speed := velocity[part].mean()) <= high:
                    points.append(
                        (speed, np.interp(speed, curve.velocity, curve.torque) + residual_torque[part].mean())
                    )
        if points:
            x, y = np.array(points).T
            own.append(Dots(x, y, "measured", COLOURS[1]))
        marks[curve.element] = own
    return _grid(marks, _SPEED, height=2.3)
