"""Plots of the pages of identifications, checks and measured runs. Torques have the unit that is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from bokeh.models import ColumnDataSource, FixedTicker
from bokeh.plotting import figure

from rx90_common.base.arrays import Array
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.style import COLOURS, GREY, INK
from rx90_emulator.identification.estimates import FrictionCurve
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import TorquePrediction

_DRAWN_S = 60.0  # s of a run in a plot: more could not be resolved
_RECORDED: Final = COLOURS[5]
_PREDICTED: Final = COLOURS[1]
_DIFFERENCE: Final = COLOURS[6]
_SPEED = "velocity of the element, rad/s"
_INTERVAL = 1.96  # standard deviations, 95 %
_DRAWN_SHARE = 20  # one of so many parts of a micro-oscillation is drawn: more loops would cover each other


def _compared(shown: figure, time: Array, recorded: tuple[str, Array], predicted: tuple[str, Array]) -> None:
    """Draw a recorded and a predicted quantity with their names."""
    shown.line(time, recorded[1], name=recorded[0], color=_RECORDED, line_width=2.4)
    shown.line(time, predicted[1], name=predicted[0], color=_PREDICTED, line_width=1.1)


def torques(torque: TorquePrediction, names: Sequence[str], unit: str, predicted: str = "predicted") -> list[figure]:
    """Show the first minute of measured and predicted torques, and their difference where a joint moves."""
    time = torque.time - torque.time[0]
    rows = slice(0, int(np.searchsorted(time, _DRAWN_S, side="right")))
    figures = []
    for k, name in enumerate(names):
        shown = chart(name, "", unit, height=120)
        _compared(shown, time[rows], ("measured", torque.recorded[rows, k]), (predicted, torque.predicted[rows, k]))
        shown.line(time[rows], torque.difference[rows, k], name="difference", color=_DIFFERENCE)
        figures.append(shown)
    over_one_x(figures, "time, s")
    return figures


def tips(check: Validation) -> list[figure]:
    """Show the distance of the tips, if there is one."""
    if not len(check.tip_distance):
        return []
    shown = chart("tips", "time, s", "distance, µm", height=120)
    shown.line(check.tip_time, check.tip_distance * 1e6, color=COLOURS[0])
    return [shown]


def measured_positions(result: MeasuredComparison) -> list[figure]:
    """Show measured and simulated positions, each beside their difference."""
    time = result.torque.time - result.torque.time[0]
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


def friction_curve(name: str, curve: FrictionCurve, unit: str) -> list[figure]:
    """Show torque against velocity of an element, with the residuals below.

    The velocity is logarithmic on either side of 0: its inverse hyperbolic sine is drawn, for want of such an axis.
    """
    speeds = np.abs(np.append(curve.line[0], curve.velocity))
    smallest = float(speeds.min())
    decades = 10.0 ** np.arange(np.ceil(np.log10(smallest)), np.floor(np.log10(speeds.max())) + 1.0)
    ticks = np.concatenate([-decades[::-1], [0.0], decades])
    places = np.arcsinh(ticks / smallest).tolist()
    above = chart(name, "", f"friction torque, {unit}")
    below = chart("", "", f"residual, {unit}")
    over_one_x([above, below], f"{_SPEED} (logarithmic on either side)")
    for shown in (above, below):
        shown.xaxis.ticker = FixedTicker(ticks=places)
        shown.xaxis.major_label_overrides = {place: f"{tick:g}" for place, tick in zip(places, ticks, strict=True)}
        (hover,) = shown.hover
        hover.tooltips = [("", "$name"), (_SPEED, "@velocity{%.6g}"), (f"torque, {unit}", "@y{%.6g}")]
        hover.formatters = {"@velocity": "printf", "@y": "printf"}
        shown.vspan([0.0], line_color=INK)
    below.hspan([0.0], line_color=INK)

    def source(velocity: Array, torque: Array, deviation: Array) -> ColumnDataSource:
        far = _INTERVAL * deviation
        columns = {"velocity": velocity, "y": torque, "low": torque - far, "high": torque + far}
        return ColumnDataSource({"x": np.arcsinh(velocity / smallest), **columns})

    for side in (curve.line[0] < 0.0, curve.line[0] > 0.0):
        velocity, torque, deviation = curve.line[:, side]
        above.line("x", "y", source=source(velocity, torque, deviation), name="identified", color=INK)
        band = source(velocity, np.zeros_like(torque), deviation)
        name_of_band = "95 % of the identified curve"
        below.varea("x", "low", "high", source=band, name=name_of_band, fill_color=GREY, fill_alpha=0.35)
    measured = source(curve.velocity, curve.torque, curve.deviation)
    above.scatter("x", "y", source=measured, name="measured", color=COLOURS[0], size=5)
    residuals = source(curve.velocity, curve.torque - curve.fitted, curve.deviation)
    noise = "measured - identified"
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
