"""The plots of the report."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rx90_common.base.arrays import Array
from rx90_common.report.drawing import COLOURS, as_svg, make_grid
from rx90_emulator.measured.comparison import MeasuredComparison

_WINDOW = 60.0  # s of a run that are drawn: more would blur
_MOST_POINTS = 1500
_PLACE: Any = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.97),
    "ncols": 3,
    "frameon": False,
    "fontsize": 8,
}  # of a legend
_MEASURED, _SIMULATED, _DIFFERENCE = COLOURS[5], COLOURS[1], COLOURS[6]


def torque_plot(result: MeasuredComparison) -> str:
    """Return measured and simulated torque and their difference, a panel for each joint, as SVG."""
    figure, axes, shown, time = _panels(result)
    difference = np.where(result.compared, result.simulated_torque - result.torque, np.nan)[shown]
    for joint, panel in enumerate(axes):
        panel.plot(time, result.torque[shown, joint], color=_MEASURED, linewidth=1.8, label="measured")
        panel.plot(time, result.simulated_torque[shown, joint], color=_SIMULATED, linewidth=0.8, label="simulated")
        panel.plot(time, difference[:, joint], color=_DIFFERENCE, linewidth=0.6, label="difference, where it moves")
        panel.set_ylabel("Nm")
    return _finished(figure, axes)


def position_plot(result: MeasuredComparison) -> str:
    """Return measured position, and how far the simulated one is from it, a panel for each joint, as SVG."""
    figure, axes, shown, time = _panels(result)
    for joint, panel in enumerate(axes):
        panel.plot(time, result.position[shown, joint], color=_MEASURED, linewidth=1.5, label="measured, rad")
        panel.set_ylabel("rad", color=_MEASURED)
        beside = panel.twinx()
        far = 1e3 * (result.simulated_position - result.position)[shown, joint]
        beside.plot(time, far, color=_SIMULATED, linewidth=0.7, label="simulated - measured, mrad")
        beside.set_ylabel("mrad", color=_SIMULATED)
        beside.grid(visible=False)
        beside.yaxis.set_major_locator(MaxNLocator(4))
        if joint == 0:
            lines = [*panel.get_lines(), *beside.get_lines()]
            panel.legend(lines, [str(line.get_label()) for line in lines], **_PLACE)
    return _finished(figure, axes, legend=False)


def _panels(result: MeasuredComparison) -> tuple[Figure, list[Axes], slice, Array]:
    figure, axes = make_grid(len(result.names), 1, 1.7)
    time = result.time - result.time[0]
    count = int(np.searchsorted(time, _WINDOW, side="right"))
    shown = slice(0, count, 1 + count // _MOST_POINTS)
    for panel, name in zip(axes, result.names, strict=True):
        panel.set_title(name, loc="left", fontsize=9)
        panel.yaxis.set_major_locator(MaxNLocator(4))
    return figure, axes, shown, time[shown]


def _finished(figure: Figure, axes: list[Axes], *, legend: bool = True) -> str:
    if legend:
        axes[0].legend(**_PLACE)
    axes[-1].set_xlabel("time since the comparison began, s")
    return as_svg(figure)
