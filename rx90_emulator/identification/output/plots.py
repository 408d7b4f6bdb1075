"""Plots of the pages of identifications and checks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from rx90_common.base.arrays import Array
from rx90_common.report.charts import chart, stacked
from rx90_common.report.style import COLOURS, GREY, INK
from rx90_emulator.identification.estimates import FrictionCurve
from rx90_emulator.identification.validation.prediction import TipDistance
from rx90_emulator.identification.validation.verdict import TorquePrediction

DRAWN_S = 60.0  # s of a run in a plot: more could not be resolved
_RECORDED = COLOURS[5]
_PREDICTED = COLOURS[1]
DIFFERENCE = COLOURS[6]
_SPEED = "speed of the element, rad/s"
_INTERVAL = 1.96  # standard deviations, 95 %


def torques(
    torque: TorquePrediction,
    names: Sequence[str],
    predicted: str = "predicted",
    unit: str = "Nm",
) -> list[figure]:
    """Show the first minute of measured and predicted torques, and their difference where a joint moves."""
    time = torque.time - torque.time[0]
    rows = slice(0, int(np.searchsorted(time, DRAWN_S, side="right")))
    lines: dict[str, tuple[Array, dict[str, Any]]] = {
        "measured": (torque.recorded[rows], {"color": _RECORDED, "line_width": 2.4}),
        predicted: (torque.predicted[rows], {"color": _PREDICTED, "line_width": 1.1}),
        "difference": (torque.difference[rows], {"color": DIFFERENCE}),
    }
    return stacked(names, ("time, s", unit), time[rows], lines)


def tips(tip: TipDistance) -> figure:
    """Show the distance of the tips."""
    shown = chart("tips", "time, s", "distance, µm", height=120)
    shown.line(tip.time, tip.distance * 1e6, color=COLOURS[0])
    return shown


def friction_curve(name: str, curve: FrictionCurve, unit: str) -> figure:
    """Show the torque against the speed of an element in both directions, with intervals of 95 %."""
    shown = chart(name, _SPEED, f"friction torque, {unit}", x_axis_type="log")
    for sign, direction, colour in ((1.0, "forward", COLOURS[0]), (-1.0, "backward", COLOURS[1])):
        line = _source(sign, *curve.line)
        shown.varea(
            "x", "low", "high", source=line, name=direction, fill_color=GREY, fill_alpha=0.35
        )
        shown.line("x", "y", source=line, name=direction, color=INK)
        measured = _source(sign, curve.velocity, curve.torque, curve.deviation)
        shown.segment("x", "low", "x", "high", source=measured, name=direction, color=colour)
        shown.scatter("x", "y", source=measured, name=direction, color=colour, size=5)
    return shown


def _source(sign: float, velocity: Array, torque: Array, deviation: Array) -> ColumnDataSource:
    """Return the points of one direction with the 95 % interval of their torque."""
    side = sign * velocity > 0.0
    far = _INTERVAL * deviation[side]
    opposing = sign * torque[side]
    return ColumnDataSource(
        {
            "x": np.abs(velocity[side]),
            "y": opposing,
            "low": opposing - far,
            "high": opposing + far,
        }
    )
