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
    """Return positions measured and simulated, and their difference beside them, a row for each joint, as SVG."""
    figure, axes, shown, time = _panels(result, columns=2)
    for joint, (panel, beside) in enumerate(zip(axes[::2], axes[1::2], strict=True)):
        panel.plot(time, result.position[shown, joint], color=_MEASURED, linewidth=1.8, label="measured")
        panel.plot(time, result.simulated_position[shown, joint], color=_SIMULATED, linewidth=0.8, label="simulated")
        panel.set_ylabel("rad")
        far = 1e3 * (result.simulated_position - result.position)[shown, joint]
        beside.plot(time, far, color=_DIFFERENCE, linewidth=0.7, label="simulated - measured")
        beside.set_ylabel("mrad")
    axes[1].legend(**_PLACE)
    return _finished(figure, axes, columns=2)


def _panels(result: MeasuredComparison, columns: int = 1) -> tuple[Figure, list[Axes], slice, Array]:
    figure, axes = make_grid(columns * len(result.names), columns, 1.7)
    time = result.time - result.time[0]
    count = int(np.searchsorted(time, _WINDOW, side="right"))
    shown = slice(0, count, 1 + count // _MOST_POINTS)
    for panel, name in zip(axes[::columns], result.names, strict=True):
        panel.set_title(name, loc="left", fontsize=9)
    for panel in axes:
        panel.yaxis.set_major_locator(MaxNLocator(4))
    return figure, axes, shown, time[shown]


def _finished(figure: Figure, axes: list[Axes], columns: int = 1) -> str:
    axes[0].legend(**_PLACE)
    for panel in axes[-columns:]:
        panel.set_xlabel("time since the comparison began, s")
    return as_svg(figure)
