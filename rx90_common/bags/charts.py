"""The page with the plots of bags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bokeh.plotting import figure

from rx90_common.bags.plotting import TopicPlot
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.page import render_page

_HEIGHT = 140


def topic_page(paths: Sequence[Path], title: str, plots: Sequence[TopicPlot]) -> str:
    """Return the text of the page on topics of one bag or two."""
    figures = [topic_figures(plot) for plot in plots]
    topics = [plot.series[0].topic for plot in plots]
    return render_page("rx90_common.bags", "bag.html.j2", title=title, paths=paths, topics=topics, figures=figures)


def topic_figures(plot: TopicPlot) -> list[figure]:
    """Show each field of a topic over the time, with its differences below."""
    figures = []
    for panel in plot.panels:
        shown = chart(panel.title, "", panel.label, height=_HEIGHT)
        figures.append(shown)
        for line in panel.lines:
            shown.line(
                line.time,
                line.values,
                name=line.name,
                color=line.colour,
                line_width=line.width,
                line_dash=line.dash,
            )
    over_one_x(figures, plot.time_label)
    return figures
