"""Plots of the check of a controller."""

from __future__ import annotations

from bokeh.plotting import figure

from rx90_common.report.charts import chart
from rx90_common.report.style import COLOURS
from rx90_emulator.conformance.case import Record

_MRAD = 1e3


def errors(record: Record, cs7b: Record) -> list[figure]:
    """Show the error of each joint over the time, with a controller and with the CS7B."""
    figures = []
    for j, name in enumerate(record.case.setup.robot.joint_names):
        shown = chart(name, "time, s", "error, mrad", height=130)
        shown.line(record.times, _MRAD * record.error[:, j], name="controller", color=COLOURS[1])
        shown.line(cs7b.times, _MRAD * cs7b.error[:, j], name="CS7B", color=COLOURS[0])
        figures.append(shown)
    return figures
