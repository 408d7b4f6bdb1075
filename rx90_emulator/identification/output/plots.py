"""Plots of the pages of identifications and checks. Torques have the unit that is given."""

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
from rx90_emulator.identification.validation.prediction import Validation
from rx90_emulator.identification.validation.verdict import TorquePrediction

DRAWN_S = 60.0  # s of a run in a plot: more could not be resolved
_RECORDED: Final = COLOURS[5]
_PREDICTED: Final = COLOURS[1]
DIFFERENCE: Final = COLOURS[6]
_SPEED = "velocity of the element, rad/s"
_INTERVAL = 1.96  # standard deviations, 95 %
_RESIDUAL = "measured - identified"
# one of so many parts of a micro-oscillation is drawn: more loops would cover each other
_DRAWN_SHARE = 20


def compared(
    shown: figure, time: Array, recorded: tuple[str, Array], predicted: tuple[str, Array]
) -> None:
    """Draw a recorded and a predicted quantity with their names."""
    shown.line(time, recorded[1], name=recorded[0], color=_RECORDED, line_width=2.4)
    shown.line(time, predicted[1], name=predicted[0], color=_PREDICTED, line_width=1.1)


def torques(
    torque: TorquePrediction, names: Sequence[str], unit: str, predicted: str = "predicted"
) -> list[figure]:
    """Show the first minute of measured and predicted torques, and their difference where a joint moves."""
    time = torque.time - torque.time[0]
    rows = slice(0, int(np.searchsorted(time, DRAWN_S, side="right")))
    figures = []
    for k, name in enumerate(names):
        shown = chart(name, "", unit, height=120)
        compared(
            shown,
            time[rows],
            ("measured", torque.recorded[rows, k]),
            (predicted, torque.predicted[rows, k]),
        )
        shown.line(time[rows], torque.difference[rows, k], name="difference", color=DIFFERENCE)
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


def friction_curve(name: str, curve: FrictionCurve, unit: str) -> list[figure]:
    """Show torque against velocity of an element, with the residuals below."""
    above = chart(name, "", f"friction torque, {unit}")
    below = chart("", "", f"residual, {unit}")
    over_one_x([above, below], f"{_SPEED} (logarithmic on either side)")
    speeds = np.abs(np.append(curve.line[0], curve.velocity))
    smallest = float(speeds.min())
    for shown in (above, below):
        _show_speeds(shown, smallest, float(speeds.max()), unit)
    below.hspan([0.0], line_color=INK)

    for side in (curve.line[0] < 0.0, curve.line[0] > 0.0):
        velocity, torque, deviation = curve.line[:, side]
        line = _source(smallest, velocity, torque, deviation)
        above.line("x", "y", source=line, name="identified", color=INK)
        band = _source(smallest, velocity, np.zeros_like(torque), deviation)
        below.varea(
            "x",
            "low",
            "high",
            source=band,
            name="95 % of the curve",
            fill_color=GREY,
            fill_alpha=0.35,
        )
    measured = _source(smallest, curve.velocity, curve.torque, curve.deviation)
    above.scatter("x", "y", source=measured, name="measured", color=COLOURS[0], size=5)
    residuals = _source(smallest, curve.velocity, curve.torque - curve.fitted, curve.deviation)
    below.segment("x", "low", "x", "high", source=residuals, name=_RESIDUAL, color=COLOURS[0])
    below.scatter("x", "y", source=residuals, name=_RESIDUAL, color=COLOURS[0], size=5)
    return [above, below]


def _show_speeds(shown: figure, smallest: float, largest: float, unit: str) -> None:
    """Let the x axis be logarithmic on either side of 0: the inverse hyperbolic sine, for want of such an axis."""
    decades = 10.0 ** np.arange(np.ceil(np.log10(smallest)), np.floor(np.log10(largest)) + 1.0)
    ticks = np.concatenate([-decades[::-1], [0.0], decades])
    places = np.arcsinh(ticks / smallest).tolist()
    shown.xaxis.ticker = FixedTicker(ticks=places)
    shown.xaxis.major_label_overrides = {
        place: f"{tick:g}" for place, tick in zip(places, ticks, strict=True)
    }
    (hover,) = shown.hover
    hover.tooltips = [("", "$name"), (_SPEED, "@velocity{%.6g}"), (f"torque, {unit}", "@y{%.6g}")]
    hover.formatters = {"@velocity": "printf", "@y": "printf"}
    shown.vspan([0.0], line_color=INK)


def _source(smallest: float, velocity: Array, torque: Array, deviation: Array) -> ColumnDataSource:
    """Return points with the 95 % interval of their torque."""
    far = _INTERVAL * deviation
    return ColumnDataSource(
        {
            "x": np.arcsinh(velocity / smallest),
            "velocity": velocity,
            "y": torque,
            "low": torque - far,
            "high": torque + far,
        }
    )


def presliding_loop(name: str, position: Array, torques: Mapping[str, Array]) -> figure:
    """Show torques against position in the middle of a micro-motion: measured and simulated."""
    count = len(position)
    part = slice(
        (_DRAWN_SHARE - 1) * count // (2 * _DRAWN_SHARE),
        (_DRAWN_SHARE + 1) * count // (2 * _DRAWN_SHARE),
    )
    shown = chart(name, "position, µrad", "friction torque, Nm", height=260)
    measured, simulated = torques
    compared(
        shown,
        position[part] * 1e6,
        (measured, torques[measured][part]),
        (simulated, torques[simulated][part]),
    )
    return shown
