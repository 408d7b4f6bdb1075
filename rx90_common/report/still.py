"""Plots as pictures: SVG text for the page, or a file in the format of its suffix. Equal plots give equal text."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator, StrMethodFormatter

from rx90_common.process.files import write_bytes
from rx90_common.report.plot import (
    MOST_POINTS,
    Band,
    Curve,
    Dots,
    Heat,
    Mark,
    Panel,
    Plot,
    simplified,
    symlog_ticks,
    symlog_transform,
)

PICTURES: Final = (".png", ".svg", ".pdf")
_WIDTH = 8.2  # inches
_LEFT, _RIGHT = 0.85, 0.12  # inches beside a panel
_ABOVE, _BELOW = 0.42, 0.48  # inches: title and legend, x label
_LEGEND_ROW = 0.17  # inches
_CHARACTER, _HANDLE = 0.058, 0.36  # inches of a legend's entry, on average
_TITLE_CHARACTER = 0.066  # inches
_DPI = 160
_FEW_DECADES = 10.0**3  # on a logarithmic axis: room for 1, 2 and 5 of each
_STEPS = [1, 2, 2.5, 5, 10]  # between ticks
_CANVAS = 1600.0, 800.0  # dots of a panel, on paper
_PATH = re.compile(r' d="[^"]*"')
_LONG_NUMBER = re.compile(r"(\d\.\d\d)\d+")  # a hundredth of a point is less than a dot of any printer
# Any: matplotlib types the keys one by one.
_STYLE: Any = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "rx90_emulator",
    "svg.fonttype": "path",
}


def as_svg(plot: Plot, most: int = MOST_POINTS) -> str:
    """Return the plot, up to `most` points of a curve, as an <svg> element."""
    buffer = io.StringIO()
    with mpl.rc_context(_STYLE):
        drawn(plot, most).savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return _PATH.sub(lambda path: _LONG_NUMBER.sub(r"\1", path[0]), text[text.index("<svg") :])


def write_picture(plot: Plot, path: Path, title: str = "") -> None:
    """Write the plot with a title as the file's suffix says, one of PICTURES.

    If that fails an old file stays as it was, and no new one.

    Raises:
        Rx90Error: if it cannot be written.
    """
    date = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix.lower())
    buffer = io.BytesIO()  # in memory: of a full disk matplotlib makes other errors
    with mpl.rc_context(_STYLE):
        figure = drawn(plot, MOST_POINTS, title)
        figure.savefig(
            buffer, format=path.suffix[1:].lower(), dpi=_DPI, metadata=None if date is None else {date: None}
        )
    write_bytes(path, buffer.getvalue())


def drawn(plot: Plot, most: int, title: str = "") -> Figure:
    """Return the plot, up to `most` points of a curve, as matplotlib's figure, below a title."""
    rows = -(-len(plot.panels) // plot.columns)
    width = (_WIDTH - _RIGHT) / plot.columns - _LEFT
    first, later = plot.panels[: plot.columns], plot.panels[plot.columns :]
    above = _ABOVE + _extra_height(first, width) + (0.3 if title else 0.0)
    between = _BELOW + (0.24 if any(panel.title for panel in later) else 0.1)
    panel = plot.height - between
    between += _extra_height(later, width)
    whole = above + rows * panel + (rows - 1) * between + _BELOW
    figure = Figure(figsize=(_WIDTH, whole))
    axes = figure.subplots(rows, plot.columns, squeeze=False).ravel()
    # Fixed margins: a layout engine takes as long as the drawing.
    figure.subplots_adjust(
        left=_LEFT / _WIDTH, right=1.0 - _RIGHT / _WIDTH, bottom=_BELOW / whole, top=1.0 - above / whole,
        hspace=between / panel, wspace=_LEFT / width,
    )  # fmt: skip
    if title:
        figure.suptitle(title, x=0.01, y=1.0 - 0.05 / whole, ha="left", va="top", fontsize=10, fontweight="bold")
    for spare in axes[len(plot.panels) :]:
        spare.remove()
    shown: set[tuple[str, ...]] = set()
    for one, ax in zip(plot.panels, axes, strict=False):
        if isinstance(one, Heat):
            _draw_heat(one, ax, figure)
            continue
        _draw_panel(one, ax, most)
        if plot.share_x:
            ax.set_xlim(*plot.x_range)
        labels = tuple(_labels(one))
        if labels and labels not in shown:
            shown.add(labels)
            _add_legend(one, ax, width)
    return figure


def _labels(panel: Panel) -> list[str]:
    return list(dict.fromkeys(mark.label for mark in panel.marks if mark.label))


def _legend_columns(panel: Panel, width: float) -> tuple[int, bool]:
    """Return how many entries of the legend go into a row of `width` inches, and whether the title has room beside."""
    labels = _labels(panel)
    entry = _HANDLE + _CHARACTER * max(map(len, labels), default=0)
    columns = max(1, min(len(labels), int(width / entry)))
    in_one_row = sum(_HANDLE + _CHARACTER * len(label) for label in labels)
    beside = columns == len(labels) and _TITLE_CHARACTER * len(panel.title) + in_one_row <= width
    return columns, beside


def _extra_height(panels: Sequence[Panel | Heat], width: float) -> float:
    """Return the inches above panels that legends need beyond one row which a title shares."""
    most = 0
    for panel in panels:
        if isinstance(panel, Panel):
            columns, beside = _legend_columns(panel, width)
            rows = -(-len(_labels(panel)) // columns)
            most = max(most, rows - (beside or not panel.title))
    return _LEGEND_ROW * most


def _add_legend(panel: Panel, axes: Axes, width: float) -> None:
    handles, labels = axes.get_legend_handles_labels()
    columns, beside = _legend_columns(panel, width)
    place: Any = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98)}
    if not panel.title:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.98)}
    elif not beside:
        axes.set_title(panel.title, loc="left", fontsize=9, pad=6.0 + 72.0 * _LEGEND_ROW * -(-len(labels) // columns))
    axes.legend(handles, labels, ncols=columns, frameon=False, fontsize=8,
                handlelength=1.4, columnspacing=1.0, **place)  # fmt: skip


def _draw_panel(panel: Panel, axes: Axes, most: int) -> None:
    seen: set[str] = set()
    for mark in panel.marks:
        _draw_mark(panel, mark, axes, "" if mark.label in seen else mark.label, most)
        seen.add(mark.label)
    if panel.x_scale == "symlog":
        transform = symlog_transform(panel.smallest)
        axes.set_xscale("symlog", base=transform.base, linthresh=transform.linthresh, linscale=transform.linscale)
        ticks = symlog_ticks(*panel.x_range, panel.smallest)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        axes.set_xscale(panel.x_scale)
    axes.set_yscale(panel.y_scale)
    if panel.x_scale == "linear":
        axes.xaxis.set_major_locator(MaxNLocator(8, steps=_STEPS))
    if panel.y_scale == "linear":
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=_STEPS))
    for axis, scale, ends in ((axes.xaxis, panel.x_scale, panel.x_range), (axes.yaxis, panel.y_scale, panel.y_range)):
        if scale == "log" and ends[1] < _FEW_DECADES * ends[0]:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_locator(NullLocator())
    axes.set(xlim=panel.x_range, ylim=panel.y_range, xlabel=panel.x_label, ylabel=panel.y_label)
    if panel.title:
        axes.set_title(panel.title, loc="left", fontsize=9)


def _draw_mark(panel: Panel, mark: Mark, axes: Axes, label: str, most: int) -> None:
    named = label or None
    if isinstance(mark, Curve):
        x, y = (mark.x, mark.y) if mark.dots else simplified(panel, mark, most, _CANVAS)
        axes.plot(x, y, color=mark.colour, linewidth=mark.width, linestyle=mark.dash,
                  marker="." if mark.dots else "", markersize=4, label=named)  # fmt: skip
    elif isinstance(mark, Dots):
        if mark.error is None:
            axes.plot(mark.x, mark.y, ".", color=mark.colour, markersize=5, label=named)
        else:
            axes.errorbar(mark.x, mark.y, mark.error, fmt=".", color=mark.colour, markersize=4, elinewidth=0.6,
                          label=named)  # fmt: skip
    elif isinstance(mark, Band):
        axes.fill_between(mark.x, mark.low, mark.high, color=mark.colour, alpha=0.35, linewidth=0.0, label=named)
    else:
        line = axes.axvline if mark.upright else axes.axhline
        line(mark.at, color=mark.colour, linewidth=0.7, linestyle=mark.dash, label=named)


def _draw_heat(heat: Heat, axes: Axes, figure: Figure) -> None:
    axes.grid(visible=False)
    image = axes.imshow(heat.values, vmin=-1.0, vmax=1.0, cmap="RdBu_r", interpolation="nearest")
    count = len(heat.names)
    size = max(3.5, min(9.0, 330.0 / max(1, count)))
    axes.set_xticks(range(count), heat.names, rotation=90, fontsize=size)
    axes.set_yticks(range(count), heat.names, fontsize=size)
    axes.tick_params(length=0)
    axes.set_title(heat.title, loc="left", fontsize=9)
    if count <= 12:  # the figures have room in their squares
        for (i, j), value in np.ndenumerate(heat.values):
            if np.isfinite(value):
                shade = "white" if abs(value) > 0.6 else "black"
                text = f"{value:.2f}".replace("-0.00", "0.00")
                axes.text(j, i, text, ha="center", va="center", fontsize=6, color=shade)
    longest = 0.075 * size / 9.0 * max(map(len, heat.names), default=0)  # inches
    height = figure.get_figheight()
    figure.subplots_adjust(left=(0.2 + longest) / _WIDTH, bottom=(0.2 + longest) / height, top=1.0 - 0.3 / height)
    figure.colorbar(image, ax=axes, shrink=0.6, label="correlation")
