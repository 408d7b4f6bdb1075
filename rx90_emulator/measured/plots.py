"""The plots of the report."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.report.plot import COLOURS, Curve, Panel, Plot
from rx90_emulator.measured.comparison import MeasuredComparison

_WINDOW = 60.0  # s of a run that are drawn: more would blur
_TIME = "time since the comparison began, s"
_MEASURED, _SIMULATED, _DIFFERENCE = COLOURS[5], COLOURS[1], COLOURS[6]


def torque_plot(result: MeasuredComparison) -> Plot:
    """Show measured and simulated torque and their difference, a panel for each joint."""
    shown, time = _window(result)
    difference = np.where(result.compared, result.simulated_torque - result.torque, np.nan)
    panels = [
        Panel(
            [
                Curve(time, result.torque[shown, joint], "measured", _MEASURED, 1.8),
                Curve(time, result.simulated_torque[shown, joint], "simulated", _SIMULATED, 0.8),
                Curve(time, difference[shown, joint], "difference, where it moves", _DIFFERENCE, 0.6),
            ],
            name,
            _TIME if joint == len(result.names) - 1 else "",
            "Nm",
        )
        for joint, name in enumerate(result.names)
    ]
    return Plot(panels, height=1.7, share_x=True)


def position_plot(result: MeasuredComparison) -> Plot:
    """Show positions measured and simulated, and their difference beside them, a row for each joint."""
    shown, time = _window(result)
    panels = []
    for joint, name in enumerate(result.names):
        measured, simulated = result.position[shown, joint], result.simulated_position[shown, joint]
        both = [
            Curve(time, measured, "measured", _MEASURED, 1.8),
            Curve(time, simulated, "simulated", _SIMULATED, 0.8),
        ]
        apart = Curve(time, 1e3 * (simulated - measured), "simulated - measured", _DIFFERENCE, 0.7)
        below = _TIME if joint == len(result.names) - 1 else ""
        panels += [Panel(both, name, below, "rad"), Panel([apart], name, below, "mrad")]
    return Plot(panels, columns=2, height=1.7, share_x=True)


def _window(result: MeasuredComparison) -> tuple[slice, Array]:
    """Return which samples are drawn, and their times, s."""
    time = result.time - result.time[0]
    shown = slice(0, int(np.searchsorted(time, _WINDOW, side="right")))
    return shown, time[shown]
