"""Plots of bags as a file: a page or a picture, by its suffix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rx90_common.bags.plotting import TopicPlot
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.process.files import write_text
from rx90_common.report.style import PICTURES


def is_page(path: Path) -> bool:
    """Return whether a file is a page, and not a picture, by its suffix."""
    kinds = (".html", *PICTURES)
    if path.suffix.lower() not in kinds:
        raise BagError(f"{plain(path)}: the suffix says what it is; accepted: {', '.join(kinds)}")
    return path.suffix.lower() == ".html"


def write_plots(paths: Sequence[Path], plots: Sequence[TopicPlot], output: Path) -> str:
    """Write the plots of bags to a page or picture, by its suffix; return the remark on different robots."""
    names = plots[0].names
    robots = next((plot.robots for plot in plots if plot.robots), ())
    each = " and ".join(f"{plain(name)} of {plain(robot)}" for name, robot in zip(names, robots, strict=False))
    note = f"two robots, {each}: drawn over each other, without a difference" if robots else ""
    if is_page(output):
        from rx90_common.bags.charts import topic_page  # Bokeh or Matplotlib, not both

        write_text(output, topic_page(paths, names, plots, note))
    else:
        from rx90_common.bags.pictures import draw_topics

        title = note or f"{' against '.join(reversed(names))}: {listed(plot.topic for plot in plots)}"
        draw_topics(plots, title, output)
    return note
