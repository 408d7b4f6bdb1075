"""The picture of bags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from rx90_common.bags.plotting import TopicLine, TopicPlot
from rx90_common.report.few_points import few_points
from rx90_common.report.picture import WIDTH, picture
from rx90_common.report.style import INK

_HEIGHT = 1.9  # inches
_MOST_POINTS = 8000  # of a line: 2000 columns, more than the dots of a panel
_CHARACTER = 0.065  # inches, on average
_HANDLE = 0.45  # inches, of a legend's entry


def draw_topics(plots: Sequence[TopicPlot], title: str, path: Path) -> None:
    """Write a picture of topics over the time, each field with its differences below."""
    rows = sum(len(plot.fields) * (1 if plot.less is None else 2) for plot in plots)
    with picture(path) as figure:
        figure.set_size_inches(WIDTH, _HEIGHT * rows + 0.3)
        figure.suptitle(title, x=0.01, ha="left", weight="bold")
        panels = iter(figure.subplots(rows, 1, sharex=True, squeeze=False).ravel())
        for plot in plots:
            for field in plot.fields:
                panel = next(panels)
                panel.set_ylabel(plot.label(field))
                _draw(panel, plot.lines(field))
                if field == plot.fields[0]:
                    _add_legend(panel, plot.topic)
                if plot.less is not None:
                    panel = next(panels)
                    panel.set(title=f"{plot.names[1]} less {plot.names[0]}", ylabel=plot.label(field))
                    panel.axhline(0.0, color=INK, linewidth=0.7)
                    _draw(panel, plot.lines_less(field))
            panel.set_xlabel(plot.time_label)


def _draw(panel: Axes, lines: Sequence[TopicLine]) -> None:
    for line in lines:
        rows = few_points(line.time, line.values, _MOST_POINTS)
        panel.plot(
            line.time[rows],
            line.values[rows],
            label=line.name,
            color=line.colour,
            linewidth=line.width,
            linestyle=line.dash,
        )


def _add_legend(panel: Axes, title: str) -> None:
    """Put a legend above a panel, with as many columns as there is room for."""
    handles, labels = panel.get_legend_handles_labels()
    columns = int((WIDTH - 1.0) / (_HANDLE + _CHARACTER * max(map(len, labels))))
    panel.legend(
        handles, labels, title=title, alignment="left", loc="lower left", bbox_to_anchor=(0, 1), ncols=max(1, columns)
    )
