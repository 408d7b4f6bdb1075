"""Plots of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from bokeh.models import DataRange1d
from bokeh.plotting import figure
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.report.charts import chart
from rx90_common.report.style import COLOURS, GREY, INK
from rx90_emulator.loop.parameters import SWITCH
from rx90_emulator.sweep.effects import MainEffect


def distribution(errors: Mapping[str, Array]) -> list[figure]:
    """Show which share of the runs stays below a path error, mm, by the errors' names; NaN where a run failed."""
    figures = []
    for k, (label, values) in enumerate(errors.items()):
        known = np.sort(values[np.isfinite(values)])
        share = np.arange(1, len(known) + 1) / len(known)
        shown = chart(
            "",
            f"{label} path error, mm",
            "share of runs at or below",
            height=220,
            y_range=DataRange1d(start=0.0),
        )
        shown.hspan([0.5], name="median", line_color=GREY, line_dash="dotted")
        shown.line(
            np.repeat(known, 2)[1:],
            np.repeat(share, 2)[:-1],
            name="runs",
            color=COLOURS[1 - k],
            line_width=2.0,
        )
        figures.append(shown)
    return figures


def main_effects(
    worst: Array, effects: Sequence[MainEffect], rows: NDArray[np.intp]
) -> list[figure]:
    """Show the worst path errors, mm, of some runs against each parameter, and the means that are its main effect."""
    figures = []
    for effect in effects:
        name, unit, _, values = effect.column
        unit = {SWITCH: " (0 off, 1 on)", "1": ""}.get(unit, f", {unit}")
        known = rows[np.isfinite(values[rows])]
        shown = chart("", f"{name}{unit}", "worst path error, mm")
        shown.scatter(values[known], worst[known], name="runs", color=COLOURS[5])
        shown.line(effect.levels, effect.means, name="mean", color=INK, line_width=2.0)
        shown.scatter(effect.levels, effect.means, name="mean", color=INK)
        figures.append(shown)
    return figures
