"""Plots as pictures, by Matplotlib: SVG text for the page, or a file. Equal plots give equal bytes."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from rx90_common.process.files import write_all
from rx90_common.report.plot import (
    LINEAR_PART,
    Band,
    Dots,
    Heat,
    Level,
    Mark,
    Panel,
    Plot,
    symlog_ticks,
    with_fewer_points,
)

PICTURES: Final = (".png", ".svg", ".pdf")
_WIDTH = 8.2  # inches
_DPI = 160
_MAX_POINTS = 8000  # of a curve: 2000 columns, more than the dots of a panel
_LEGEND_ROW = 12.0  # points
# inches of a legend's entry: a character on average, the line before it
_CHARACTER = 0.062
_HANDLE = 0.42
_TITLE_CHARACTER = 0.072  # inches
_FEW_DECADES = 1e3  # on a logarithmic axis: room for 1, 2 and 5 of each
_SUBS = (1.0, 2.0, 5.0)  # of a decade, that have a tick
_LONG_NUMBER = re.compile(r"(\d\.\d\d)\d+")  # a hundredth of a point is less than a dot of any printer
# Any: matplotlib types the keys one by one.
_STYLE: Any = {
    "svg.hashsalt": "rx90_emulator",
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.0,
    "legend.borderaxespad": 0.1,
    "legend.borderpad": 0.1,
    "path.simplify_threshold": 0.5,
    "text.parse_math": False,  # a dollar in a name from outside makes no formula
}


@contextmanager
def _styled() -> Iterator[None]:
    """Draw in the style of all plots; letters that the font does not have, and names without room, make no warning."""
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        warnings.filterwarnings("ignore", "constrained_layout not applied")
        yield


def as_svg(plot: Plot, most: int = _MAX_POINTS) -> str:
    """Return the plot, up to about `most` points of a curve, as an <svg> element."""

    def shorter(found: re.Match[str]) -> str:
        """Return a path with shorter numbers, and without the letter of each line where it has no curves."""
        path = _LONG_NUMBER.sub(r"\1", found[0])
        return path if re.search("[CQ]", path) else re.sub(r" *\nL ", " ", path)

    buffer = io.StringIO()
    with _styled():
        drawn(plot, most).savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return re.sub(r' d="[^"]*"', shorter, text[text.index("<svg") :])


def write_picture(plot: Plot, path: Path, title: str = "") -> None:
    """Write the plot with a title in the format of the file's suffix, one of PICTURES.

    If that fails an old file stays unchanged, and no new one is left.
    """
    date = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix.lower())
    buffer = io.BytesIO()  # in memory: of a full disk matplotlib makes other errors
    with _styled():
        drawn(plot, _MAX_POINTS, title).savefig(
            buffer, format=path.suffix[1:].lower(), dpi=_DPI, metadata=None if date is None else {date: None}
        )
    write_all({path: buffer.getvalue()})


def drawn(plot: Plot, most: int = _MAX_POINTS, title: str = "") -> Figure:
    """Return the plot, up to about `most` points of a curve, as Matplotlib's figure, below a title."""
    plot = with_fewer_points(plot, most)
    rows = -(-len(plot.panels) // plot.columns)
    figure = Figure(figsize=(_WIDTH, rows * plot.height + (0.3 if title else 0.0)), layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.0, fontweight="bold")
    every = figure.subplots(rows, plot.columns, squeeze=False).ravel()
    shown: set[tuple[str, ...]] = set()
    for axes, panel in zip(every, plot.panels, strict=False):
        if isinstance(panel, Heat):
            _draw_heat(axes, panel)
            continue
        _draw_panel(axes, panel, plot.x_range if plot.share_x else panel.x_range, max(4, 10 - 2 * plot.columns))
        labels = tuple(dict.fromkeys(mark.label for mark in panel.marks if mark.label))
        rows_above = 0
        if labels and labels not in shown:  # equal legends are shown once
            shown.add(labels)
            rows_above = _draw_legend(axes, panel, labels, _WIDTH / plot.columns - 1.0)
        axes.set_title(panel.title, pad=4.0 + _LEGEND_ROW * rows_above)
    for axes in every[len(plot.panels) :]:
        axes.set_axis_off()
    return figure


def _draw_panel(axes: Axes, panel: Panel, x_range: tuple[float, float], most_ticks: int) -> None:
    scales = {"linthresh": panel.smallest, "linscale": LINEAR_PART} if panel.x_scale == "symlog" else {}
    axes.set_xscale(panel.x_scale, **scales)
    axes.set_yscale(panel.y_scale)
    for mark in panel.marks:
        _draw_mark(axes, mark)
    axes.set(xlim=x_range, ylim=panel.y_range, xlabel=panel.x_label, ylabel=panel.y_label)
    for axis, scale, (low, high) in ((axes.xaxis, panel.x_scale, x_range), (axes.yaxis, panel.y_scale, panel.y_range)):
        if scale == "linear":
            axis.set_major_locator(MaxNLocator(most_ticks if axis is axes.xaxis else 5, steps=[1, 2, 2.5, 5, 10]))
        elif scale == "symlog":
            axis.set_ticks(symlog_ticks(low, high, panel.smallest))
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_locator(NullLocator())
        elif high < _FEW_DECADES * low:
            axis.set(major_locator=LogLocator(subs=_SUBS), major_formatter="{x:g}")
            axis.set_minor_locator(NullLocator())
        else:
            axis.set_major_formatter(lambda value, _: f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e"))


def log_ticks(low: float, high: float) -> list[float]:
    """Return the ticks of a logarithmic axis over a few decades, none for more."""
    ticks = LogLocator(subs=_SUBS).tick_values(low, high) if high < _FEW_DECADES * low else []
    return [float(tick) for tick in ticks if low <= tick <= high]


def _draw_mark(axes: Axes, mark: Mark) -> None:
    look: Any = {"color": mark.colour, "label": mark.label}
    if isinstance(mark, Level):
        (axes.axvline if mark.upright else axes.axhline)(mark.at, linewidth=0.7, linestyle=mark.dash, **look)
    elif isinstance(mark, Band):
        axes.fill_between(mark.x, mark.low, mark.high, alpha=0.35, linewidth=0.0, **look)
    elif isinstance(mark, Dots):
        size = 4.0 if mark.error is None else 5.0
        axes.errorbar(mark.x, mark.y, mark.error, fmt=".", markersize=size, elinewidth=0.6, **look)
    else:
        dots = "." if mark.dots else ""
        axes.plot(mark.x, mark.y, marker=dots, markersize=4.0, linewidth=mark.width, linestyle=mark.dash, **look)


def _draw_legend(axes: Axes, panel: Panel, labels: tuple[str, ...], width: float) -> int:
    """Draw the legend above the panel, right of the title, and return its number of rows below the title."""
    columns = max(1, min(len(labels), int(width / (_HANDLE + _CHARACTER * max(map(len, labels))))))
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(handles.values(), handles, loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=columns)
    used = sum(_HANDLE + _CHARACTER * len(label) for label in labels)
    fits_beside_title = columns == len(labels) and _TITLE_CHARACTER * len(panel.title) + used <= width
    return 0 if fits_beside_title or not panel.title else -(-len(labels) // columns)


def _draw_heat(axes: Axes, heat: Heat) -> None:
    """Draw correlations as a square of colours with the names beside it, and the scale of the colours."""
    count = len(heat.names)
    image = axes.imshow(np.ma.masked_invalid(heat.values), cmap="RdBu_r", vmin=-1.0, vmax=1.0, interpolation="nearest")
    size = max(3.5, min(9.0, 330.0 / max(1, count)))
    axes.set_xticks(range(count), heat.names, rotation=90.0, fontsize=size)
    axes.set_yticks(range(count), heat.names, fontsize=size)
    axes.grid(visible=False)
    axes.set_title(heat.title)
    if count <= 12:  # the figures have room in their squares
        for (i, j), value in np.ndenumerate(heat.values):
            if np.isfinite(value):
                words = f"{value:.2f}".replace("-0.00", "0.00")
                shade = "white" if abs(value) > 0.6 else "black"
                axes.text(j, i, words, fontsize=6.0, ha="center", va="center", color=shade)
    colours = axes.figure.colorbar(image, ax=axes, shrink=0.6, ticks=[-1, 0, 1])
    colours.set_label("correlation")
