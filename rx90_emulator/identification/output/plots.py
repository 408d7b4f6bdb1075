"""Plots of the pages of identifications, checks and measured runs. Torques have the unit that is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from bokeh.models import ColumnDataSource, FixedTicker
from bokeh.palettes import RdBu11, interp_palette
from bokeh.plotting import figure
from bokeh.transform import linear_cmap

from rx90_common.base.arrays import Array
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.style import COLOURS, GREY, INK
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.sliding import CurvePoints
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import RunTorques

_DRAWN_S = 60.0  # s of a run in a plot: more could not be resolved
_RECORDED: Final = COLOURS[5]
_PREDICTED: Final = COLOURS[1]
_DIFFERENCE: Final = COLOURS[6]
_TIME = "time since the first motion, s"
_SPEED = "velocity of the element, rad/s"
_INTERVAL = 1.96  # standard deviations, 95 %
_DRAWN_SHARE = 20  # one of so many parts of a micro-oscillation is drawn: more loops would cover each other
_SPEED_BINS = 20
_MIN_BIN_SAMPLES = 8  # least number of samples in a bin


def _compared(shown: figure, time: Array, recorded: tuple[str, Array], predicted: tuple[str, Array]) -> None:
    """Draw a recorded and a predicted quantity with their names."""
    shown.line(time, recorded[1], name=recorded[0], color=_RECORDED, line_width=2.4)
    shown.line(time, predicted[1], name=predicted[0], color=_PREDICTED, line_width=1.1)


def validation(check: Validation) -> list[figure]:
    """Show the torques of a validation, and the distance of the tips if there is one."""
    torque = check.torque
    figures = []
    for k, name in enumerate(check.names):
        shown = chart(name, "", check.unit, height=120)
        _compared(shown, torque.time, ("recorded", torque.recorded[:, k]), ("predicted", torque.predicted[:, k]))
        shown.line(torque.time, torque.difference[:, k], name="difference", color=_DIFFERENCE)
        figures.append(shown)
    if len(check.tip_distance):
        shown = chart("tips", "", "distance, µm", height=120)
        shown.line(check.tip_time, check.tip_distance * 1e6, color=COLOURS[0])
        figures.append(shown)
    over_one_x(figures, "time, s")
    return figures


def measured_torques(result: MeasuredComparison) -> list[figure]:
    """Show measured and simulated torques."""
    torque = result.agreement
    time = result.time - result.time[0]
    rows = slice(0, int(np.searchsorted(time, _DRAWN_S, side="right")))
    figures = []
    for k, name in enumerate(result.names):
        shown = chart(name, "", "Nm", height=120)
        _compared(shown, time[rows], ("measured", torque.recorded[rows, k]), ("simulated", torque.predicted[rows, k]))
        shown.line(time[rows], torque.difference[rows, k], name="difference", color=_DIFFERENCE)
        figures.append(shown)
    over_one_x(figures, "time since the comparison began, s")
    return figures


def measured_positions(result: MeasuredComparison) -> list[figure]:
    """Show measured and simulated positions, each beside their difference."""
    time = result.time - result.time[0]
    rows = slice(0, int(np.searchsorted(time, _DRAWN_S, side="right")))
    figures = []
    for k, name in enumerate(result.names):
        measured = result.position[rows, k]
        simulated = result.simulated_position[rows, k]
        positions = chart(name, "", "rad", height=120)
        _compared(positions, time[rows], ("measured", measured), ("simulated", simulated))
        difference = chart(name, "", "mrad", height=120)
        difference.line(time[rows], 1e3 * (simulated - measured), name="simulated - measured", color=_DIFFERENCE)
        figures += [positions, difference]
    over_one_x(figures, "time since the comparison began, s", across=2)
    return figures


def sliding_curve(name: str, curve: CurvePoints) -> list[figure]:
    """Show torque against velocity of an element, with the residuals below.

    The velocity is logarithmic on either side of 0: its inverse hyperbolic sine is drawn, for want of such an axis.
    """
    smallest = float(np.abs(curve.velocity).min())
    above = chart(name, "", "friction torque, Nm")
    below = chart("", "", "residual, Nm")
    over_one_x([above, below], f"{_SPEED} (logarithmic on either side)")
    largest = float(np.abs(np.append(curve.line[0], curve.velocity)).max())
    decades = 10.0 ** np.arange(np.ceil(np.log10(smallest)), np.floor(np.log10(largest)) + 1.0)
    ticks = np.concatenate([-decades[::-1], [0.0], decades])
    places = np.arcsinh(ticks / smallest).tolist()
    for shown in (above, below):
        shown.xaxis.ticker = FixedTicker(ticks=places)
        shown.xaxis.major_label_overrides = {place: f"{tick:g}" for place, tick in zip(places, ticks, strict=True)}
        (hover,) = shown.hover
        hover.tooltips = [("", "$name"), (_SPEED, "@velocity{%.6g}"), ("torque, Nm", "@y{%.6g}")]
        hover.formatters = {"@velocity": "printf", "@y": "printf"}
        shown.vspan([0.0], line_color=INK)
    below.hspan([0.0], line_color=INK)

    def source(velocity: Array, torque: Array, **columns: Array) -> ColumnDataSource:
        return ColumnDataSource({"x": np.arcsinh(velocity / smallest), "velocity": velocity, "y": torque, **columns})

    for side in (curve.line[0] < 0.0, curve.line[0] > 0.0):
        velocity, torque, deviation = curve.line[:, side]
        above.line("x", "y", source=source(velocity, torque), name="identified", color=INK)
        far = _INTERVAL * deviation
        below.varea(
            np.arcsinh(velocity / smallest),
            -far,
            far,
            name="95 % of the identified curve",
            fill_color=GREY,
            fill_alpha=0.35,
        )
    measured = source(curve.velocity, curve.torque)
    above.scatter("x", "y", source=measured, name="measured, one stretch each", color=COLOURS[0], size=5)
    residual = curve.torque - curve.fitted
    far = _INTERVAL * curve.deviation
    residuals = source(curve.velocity, residual, low=residual - far, high=residual + far)
    noise = "measured - identified, 95 % of the noise"
    below.segment("x", "low", "x", "high", source=residuals, name=noise, color=COLOURS[0])
    below.scatter("x", "y", source=residuals, name=noise, color=COLOURS[0], size=5)
    return [above, below]


def presliding_loop(name: str, position: Array, torques: Mapping[str, Array]) -> figure:
    """Show torques against position in the middle of a micro-motion: measured and simulated."""
    count = len(position)
    part = slice((_DRAWN_SHARE - 1) * count // (2 * _DRAWN_SHARE), (_DRAWN_SHARE + 1) * count // (2 * _DRAWN_SHARE))
    shown = chart(name, "position, µrad", "friction torque, Nm", height=260)
    measured, simulated = torques
    _compared(shown, position[part] * 1e6, (measured, torques[measured][part]), (simulated, torques[simulated][part]))
    return shown


def correlation(names: Sequence[str], values: Array, title: str = "") -> figure:
    """Show correlations from -1 to 1, (k, k), as colours; nothing where they are NaN."""
    count = len(names)
    row, column = np.nonzero(np.isfinite(values))
    known = np.array(names)
    shown = chart(
        title,
        height=None,
        aspect_ratio=1,
        max_width=900 if count > 12 else 420,
        x_range=list(names),
        y_range=list(names[::-1]),
    )
    source = ColumnDataSource({"x": known[column].tolist(), "y": known[row].tolist(), "value": values[row, column]})
    colour = linear_cmap("value", interp_palette(RdBu11, 256), -1.0, 1.0)
    squares = shown.rect("x", "y", 1, 1, source=source, line_color=None, fill_color=colour)
    shown.add_layout(squares.construct_color_bar(width=10), "right")
    shown.axis.major_label_text_font_size = f"{6 if count > 30 else 8 if count > 12 else 11}px"
    shown.xaxis.major_label_orientation = np.pi / 2.0
    shown.grid.grid_line_color = None
    (hover,) = shown.hover
    hover.tooltips = [("", "@y"), ("", "@x"), ("correlation", "@value{%.6g}")]
    hover.formatters = {"@value": "printf"}
    return shown


def _start(run: RunTorques) -> float:
    return min((float(joint.time[0]) for joint in run.joints if len(joint.time)), default=0.0)


def excitation_run(run: RunTorques, unit: str) -> list[figure]:
    """Show the torques of the first part of a run, with gaps where a joint stands still."""
    figures = []
    for name, joint in zip(run.names, run.joints, strict=True):
        count = max(1, int(np.searchsorted(joint.time, _start(run) + _DRAWN_S)))
        time, _, recorded, predicted = (values[:count] for values in joint)
        steps = np.diff(time)
        gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)
        rows = (time - _start(run), recorded, predicted, recorded - predicted)
        time, recorded, predicted, residual = (np.insert(values, gaps, np.nan) for values in rows)
        shown = chart(name, "", unit, height=120)
        _compared(shown, time, ("measured", recorded), ("predicted", predicted))
        shown.line(time, residual, name="difference", color=_DIFFERENCE)
        figures.append(shown)
    over_one_x(figures, _TIME)
    return figures


def residual_by_speed(result: ExcitationIdentification, unit: str) -> list[figure]:
    """Show the mean residual against the velocity of each element, with 95 % intervals."""
    figures = []
    for one in result.speeds:
        shown = chart(one.element, _SPEED, unit, height=140)
        shown.hspan([0.0], line_color=_DIFFERENCE)
        if len(one.velocity):
            bars = _INTERVAL * np.nan_to_num(one.deviation)
            name = "mean of a bin, 95 %"
            shown.line(one.velocity, one.residual, name=name, color=COLOURS[0])
            low = one.residual - bars
            high = one.residual + bars
            shown.segment(one.velocity, low, one.velocity, high, name=name, color=COLOURS[0])
            shown.scatter(one.velocity, one.residual, name=name, color=COLOURS[0], size=5)
        figures.append(shown)
    return figures


def residual_by_time(runs: Sequence[RunTorques], block: float, unit: str) -> list[figure]:
    """Show the mean of the residual against the motion over blocks of time, s, each run with its colour."""
    figures = []
    for number, joint_name in enumerate(runs[0].names):
        shown = chart(joint_name, _TIME, unit, height=140)
        shown.hspan([0.0], line_color=_DIFFERENCE)
        for which, run in enumerate(runs):
            joint = run.joints[number]
            if not len(joint.time):
                continue
            name = run.source.path.name if 1 < len(runs) <= len(COLOURS) else None
            colour = COLOURS[which % len(COLOURS)]
            place = ((joint.time - _start(run)) / block).astype(np.intp)
            count = np.bincount(place)
            used = np.flatnonzero(count)
            means = np.bincount(place, joint.residual * np.sign(joint.velocity))[used] / count[used]
            middle = (used + 0.5) * block
            shown.line(middle, means, name=name, color=colour)
            shown.scatter(middle, means, name=name, color=colour)
        figures.append(shown)
    return figures


def friction_curves(result: ExcitationIdentification, unit: str) -> list[figure]:
    """Show the friction torque of each element against its velocity, its band, and means of the measured torque.

    The means belong to the joint's own element: its curve plus the mean residual, in bins of each sign with about the
    same number of samples.
    """
    problem = result.problem
    residual = problem.torque - result.friction.predicted
    joints = np.flatnonzero(problem.arm.identified)
    figures = []
    for number, curve in enumerate(result.friction.curves()):
        shown = chart(curve.element, _SPEED, unit, height=180)
        shown.hspan([0.0], line_color=_DIFFERENCE)
        shown.vspan([0.0], line_color=_DIFFERENCE)
        has_own_joint = number < len(joints)  # a coupled element has no joint of its own
        rows = np.flatnonzero((problem.joint == joints[number]) & ~problem.reversal) if has_own_joint else joints[:0]
        velocity = problem.velocity[rows, number]
        residual_torque = residual[rows]
        low, high = (curve.velocity.min(), curve.velocity.max()) if len(curve.velocity) else (0.0, 0.0)
        points = []
        for sign in (-1.0, 1.0):
            side = sign * curve.velocity > 0.0
            low_side, high_side = (bound[side] for bound in curve.band)
            shown.varea(curve.velocity[side], low_side, high_side, name="95 %", fill_color=COLOURS[5], fill_alpha=0.35)
            shown.line(curve.velocity[side], curve.torque[side], name="identified", color=COLOURS[0], line_width=1.6)
            one_sign = np.flatnonzero(sign * velocity > 0.0)
            for part in np.array_split(one_sign[np.argsort(velocity[one_sign])], _SPEED_BINS // 2):
                if len(part) >= _MIN_BIN_SAMPLES and low <= (speed := velocity[part].mean()) <= high:
                    points.append(
                        (speed, np.interp(speed, curve.velocity, curve.torque) + residual_torque[part].mean())
                    )
        if points:
            x, y = np.array(points).T
            shown.scatter(x, y, name="measured", color=COLOURS[1], size=5)
        figures.append(shown)
    return figures
