"""The page with the plots of bags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bokeh.plotting import figure

from rx90_common.bags.plotting import TopicPlot
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.page import render_page
from rx90_common.report.style import INK

_HEIGHT = 140


def topic_page(paths: Sequence[Path], names: Sequence[str], plots: Sequence[TopicPlot], robots: str) -> str:
    """Return the text of the page on topics of one bag or two.

    Args:
        paths: of the bags.
        names: of the bags.
        plots: of the topics.
        robots: a remark on different robots, or "".
    """
    return render_page(
        "rx90_common.bags",
        "bag.html.j2",
        names=names,
        paths=paths,
        plots=plots,
        figures=[topic_figures(plot) for plot in plots],
        robots=robots,
    )


def topic_figures(plot: TopicPlot) -> list[figure]:
    """Show each field of a topic over the time, with its differences below."""
    figures: list[figure] = []
    for field in plot.fields:
        shown = chart("" if figures else plot.topic, "", plot.label(field), height=_HEIGHT)
        figures.append(shown)
        for line in plot.lines(field):
            shown.line(
                line.time,
                line.values,
                name=line.name,
                color=line.colour,
                line_width=line.width,
                line_dash=line.dash,
            )
        if plot.less is not None:
            title = f"{plot.names[1]} less {plot.names[0]}"
            shown = chart(title, "", plot.label(field), height=_HEIGHT)
            figures.append(shown)
            shown.hspan([0.0], line_color=INK)
            for line in plot.lines_less(field):
                shown.line(line.time, line.values, name=line.name, color=line.colour)
    over_one_x(figures, plot.time_label)
    return figures
