"""The picture of bags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rx90_common.bags.plotting import TopicPlot
from rx90_common.report.few_points import few_points
from rx90_common.report.picture import WIDTH, picture

_HEIGHT = 1.9  # inches
_MOST_POINTS = 8000  # of a line: 2000 columns, more than the dots of a panel


def draw_topics(plots: Sequence[TopicPlot], title: str, path: Path) -> None:
    """Write a picture of topics over the time, each field with its differences below."""
    panels = [panel for plot in plots for panel in plot.panels]
    with picture(path) as figure:
        figure.set_size_inches(WIDTH, _HEIGHT * len(panels) + 0.3)
        figure.suptitle(title, x=0.01, ha="left", weight="bold")
        frames = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
        for frame, panel in zip(frames, panels, strict=True):
            frame.set(title=panel.title, ylabel=panel.label)
            for line in panel.lines:
                rows = few_points(line.time, line.values, _MOST_POINTS)
                style = {"color": line.colour, "linewidth": line.width, "linestyle": line.dash}
                frame.plot(line.time[rows], line.values[rows], label=line.name, **style)
            frame.legend(loc="upper right", ncols=2)
        frames[-1].set_xlabel(plots[0].time_label)
