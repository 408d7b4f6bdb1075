"""Picture of what an export makes of the friction."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from rx90_common.report.picture import WIDTH, picture, plain_decades
from rx90_common.report.style import COLOURS, INK
from rx90_emulator.export.fit import FrictionFit, sum_of

_ACROSS = 3


def draw_fits(fits: Mapping[str, FrictionFit], path: Path) -> None:
    """Write a picture of friction torques, here and in the simulator, each below its title."""
    columns = min(_ACROSS, len(fits))
    rows = -(-len(fits) // columns)
    with picture(path) as figure:
        figure.set_size_inches(WIDTH, 2.2 * rows + 0.3)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for panel in panels[len(fits) :]:
            panel.set_axis_off()
        for panel, (title, fit) in zip(panels, fits.items(), strict=False):
            _draw_fit(panel, fit)
            panel.set_title(title)
        lines = {line.get_label(): line for panel in panels for line in panel.lines}
        figure.legend(handles=list(lines.values()), loc="upper right", ncols=len(lines))
        figure.suptitle("Friction torque", x=0.01, ha="left", weight="bold")


def _draw_fit(panel: Axes, fit: FrictionFit) -> None:
    """Draw the friction torque of an element, of both signs where these differ, and the exported one."""
    speed = np.sort(fit.speeds)
    forward = sum_of(fit.elements, speed, 1.0)
    backward = sum_of(fit.elements, speed, -1.0)
    panel.semilogx(speed, forward, color=INK, label="here")
    if not np.array_equal(forward, backward):
        panel.semilogx(speed, backward, color=COLOURS[5], label="here, negative velocity")
    panel.semilogx(speed, fit.law.torque(speed), "--", color=COLOURS[1], label="exported")
    plain_decades(panel)
    panel.set(xlabel="velocity, rad/s", ylabel="torque, Nm")
