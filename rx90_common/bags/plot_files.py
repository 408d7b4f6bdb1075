"""Plots of bags as a file: a page or a picture, by its suffix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rx90_common.bags.plotting import TopicPlot
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.process.files import write_text
from rx90_common.report.style import PICTURES


def write_plots(paths: Sequence[Path], plots: Sequence[TopicPlot], output: Path) -> None:
    """Write the plots of bags to a page or a picture, by its suffix."""
    title = f"{' against '.join(reversed(plots[0].names))}: {listed(plot.series[0].topic for plot in plots)}"
    if output.suffix.lower() == ".html":
        from rx90_common.bags.charts import topic_page  # Bokeh or Matplotlib, not both

        write_text(output, topic_page(paths, title, plots))
    elif output.suffix.lower() in PICTURES:
        from rx90_common.bags.pictures import draw_topics

        draw_topics(plots, title, output)
    else:
        raise BagError(f"{plain(output)}: the suffix says what it is; accepted: .html, {', '.join(PICTURES)}")
