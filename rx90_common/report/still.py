"""Plots as pictures: SVG text for the page, or a file in the format of its suffix. Equal plots give equal text."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from rx90_common.base.arrays import Array
from rx90_common.process.files import write_bytes
from rx90_common.report.plot import Band, Curve, Dots, Heat, Level, Mark, Panel, Plot
from rx90_common.report.sheet import POINT, Sheet, text_width
from rx90_common.report.simplifying import MOST_POINTS, Extent, simplified
from rx90_common.report.still_heat import draw_heat
from rx90_common.report.thinning import thinned
from rx90_common.report.ticks import Axis, AxisTicks, ticks_of

PICTURES: Final = (".png", ".svg", ".pdf")
_WIDTH = 8.2  # inches
_LEFT, _RIGHT = 0.85, 0.12  # inches beside a panel
_ABOVE, _BELOW = 0.42, 0.48  # inches: title and legend, x label
_LEGEND_ROW = 0.17  # inches
_CHARACTER, _HANDLE = 0.058, 0.36  # inches of a legend's entry, on average
_TITLE_CHARACTER = 0.066  # inches
_SMALL = 8.0  # points: the font of legends
_HANDLE_WIDTH, _HANDLE_SPACE, _COLUMN_SPACE, _LEGEND_PAD = 11.2 * POINT, 6.4 * POINT, 8.0 * POINT, 7.2 * POINT
_TICK, _SMALL_TICK = 3.5 * POINT, 2.0 * POINT
_X_LABEL = 20.4 * POINT  # below the panel
_LINE = 11.0 * POINT  # a line of text
_BAR = 0.6  # points: the line of an error bar
_BAND_ALPHA = 0.35
_MARKER: Any = {"marker": ".", "markersize": 4.0}
_DPI = 160
_CANVAS = 1600.0, 800.0  # dots of a panel, on paper
_PATH = re.compile(r' d="[^"]*"')
_LONG_NUMBER = re.compile(r"(\d\.\d\d)\d+")  # a hundredth of a point is less than a dot of any printer
# Any: matplotlib types the keys one by one.
_STYLE: Any = {"svg.hashsalt": "rx90_emulator", "svg.fonttype": "path"}


def as_svg(plot: Plot, most: int = MOST_POINTS) -> str:
    """Return the plot, up to `most` points of a curve, as an <svg> element."""
    buffer = io.StringIO()
    with mpl.rc_context(_STYLE):
        drawn(plot, most).savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return _PATH.sub(lambda path: _short(path[0]), text[text.index("<svg") :])


def _short(path: str) -> str:
    """Return the text of a path with shorter numbers, and one letter for lines that follow each other."""
    first, *lines = _LONG_NUMBER.sub(r"\1", path).split("\n")
    for before, line in zip([first, *lines], lines, strict=False):
        first += line[1:].rstrip() if line[:1] == before[:1] == "L" else f" {line.rstrip()}"
    return first


def write_picture(plot: Plot, path: Path, title: str = "") -> None:
    """Write the plot with a title as the file's suffix says, one of PICTURES.

    If that fails an old file stays as it was, and no new one.

    Raises:
        Rx90Error: if it cannot be written.
    """
    date = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix.lower())
    buffer = io.BytesIO()  # in memory: of a full disk matplotlib makes other errors
    with mpl.rc_context(_STYLE):
        figure = drawn(thinned(plot), MOST_POINTS, title)
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
    height = plot.height - between
    between += _extra_height(later, width)
    sheet = Sheet(_WIDTH, above + rows * height + (rows - 1) * between + _BELOW)
    sheet.text(0.01 * _WIDTH, sheet.height - 0.05, title, 10.0, bold=True, va="top")
    shown: set[tuple[str, ...]] = set()
    for k, panel in enumerate(plot.panels):
        row, column = divmod(k, plot.columns)
        bottom = sheet.height - above - height - row * (height + between)
        left = _LEFT + column * (width + _LEFT)
        if isinstance(panel, Heat):
            top = bottom + height + (above if row == 0 else between - _BELOW)
            draw_heat(panel, sheet, Bbox.from_extents(left - _LEFT, bottom - _BELOW, left + width, top))
            continue
        labels = tuple(_labels(panel))
        box = Bbox.from_bounds(left, bottom, width, height)
        title_at = box.y1 + 6.0 * POINT
        if labels and labels not in shown:
            shown.add(labels)
            title_at += _draw_legend(panel, sheet, box)
        _draw_panel(panel, sheet, box, plot.x_range if plot.share_x else panel.x_range, most)
        sheet.text(box.x0, title_at, panel.title)
    return sheet.figure


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


def _draw_legend(panel: Panel, sheet: Sheet, box: Bbox) -> float:
    """Draw the entries above the panel, and return how much higher than usual its title stands, inches."""
    named = {mark.label: mark for mark in reversed(panel.marks) if mark.label}
    labels = _labels(panel)
    columns, beside = _legend_columns(panel, box.width)
    rows = -(-len(labels) // columns)
    parts = [labels[k : k + rows] for k in range(0, len(labels), rows)]
    widths = [_HANDLE_WIDTH + _HANDLE_SPACE + max(text_width(label, _SMALL) for label in part) for part in parts]
    whole = sum(widths) + _COLUMN_SPACE * (len(parts) - 1)
    x = box.x1 - _LEGEND_PAD - whole if panel.title else 0.5 * (box.x0 + box.x1 - whole)
    for part, width in zip(parts, widths, strict=True):
        for k, label in enumerate(part):
            y = box.y0 + 0.98 * box.height + _LEGEND_PAD + _LEGEND_ROW * (rows - 1 - k) + 2.0 * POINT
            _draw_handle(named[label], sheet, x, y + 2.5 * POINT)
            sheet.text(x + _HANDLE_WIDTH + _HANDLE_SPACE, y, label, _SMALL)
        x += width + _COLUMN_SPACE
    return 0.0 if beside or not panel.title else _LEGEND_ROW * rows


def _draw_handle(mark: Mark, sheet: Sheet, x: float, y: float) -> None:
    ends, middle = np.array([x, x + _HANDLE_WIDTH]), np.array([x + 0.5 * _HANDLE_WIDTH])
    if isinstance(mark, Band):
        low, high = y - 2.8 * POINT, y + 2.8 * POINT
        outline = np.array([[ends[0], low], [ends[1], low], [ends[1], high], [ends[0], high]])
        sheet.area([outline], mark.colour, alpha=_BAND_ALPHA)
    elif isinstance(mark, Dots):
        if mark.error is not None:
            bar = np.array([[[middle[0], y - 4.0 * POINT], [middle[0], y + 4.0 * POINT]]])
            sheet.segments(bar, mark.colour, _BAR)
        sheet.line(middle, np.array([y]), **_dots(mark))
    else:
        sheet.line(ends, np.array([y, y]), **_line(mark))
        if isinstance(mark, Curve) and mark.dots:
            sheet.line(middle, np.array([y]), color=mark.colour, linestyle="", **_MARKER)


def _draw_panel(panel: Panel, sheet: Sheet, box: Bbox, x_range: tuple[float, float], most: int) -> None:
    axes = (
        Axis(panel.x_scale, x_range, panel.smallest, box.x0, box.width),
        Axis(panel.y_scale, panel.y_range, panel.smallest, box.y0, box.height),
    )
    ticks = ticks_of(axes[0], 8), ticks_of(axes[1], 5)
    x, y = (axis.place(one.values) for axis, one in zip(axes, ticks, strict=True))
    lines = [[(at, box.y0), (at, box.y1)] for at in x] + [[(box.x0, at), (box.x1, at)] for at in y]
    sheet.segments(np.array(lines), "#b0b0b0", 0.8, alpha=0.3)
    for mark in panel.marks:
        _draw_mark(panel, mark, sheet, axes, box, most)
    _draw_ticks(sheet, box, axes, ticks)
    _write_labels(panel, sheet, box, (x, y), ticks)


def _draw_ticks(sheet: Sheet, box: Bbox, axes: tuple[Axis, Axis], ticks: tuple[AxisTicks, AxisTicks]) -> None:
    """Draw the lines of both axes, with their ticks."""
    x, y = (axis.place(one.values) for axis, one in zip(axes, ticks, strict=True))
    corners = [[(box.x0, box.y0), (box.x1, box.y0)], [(box.x0, box.y0), (box.x0, box.y1)]]
    large = [[(at, box.y0), (at, box.y0 - _TICK)] for at in x] + [[(box.x0, at), (box.x0 - _TICK, at)] for at in y]
    sheet.segments(np.array(corners + large), "black", 0.8)
    small_x, small_y = (axis.place(one.between) for axis, one in zip(axes, ticks, strict=True))
    small = [[(at, box.y0), (at, box.y0 - _SMALL_TICK)] for at in small_x]
    small += [[(box.x0, at), (box.x0 - _SMALL_TICK, at)] for at in small_y]
    sheet.segments(np.array(small), "black", 0.6)


def _write_labels(
    panel: Panel, sheet: Sheet, box: Bbox, places: tuple[Array, Array], ticks: tuple[AxisTicks, AxisTicks]
) -> None:
    """Write beside the axes what their ticks and they themselves stand for; `places` of the ticks, inches."""
    (x, y), (x_ticks, y_ticks) = places, ticks
    for at, label in zip(x, x_ticks.labels, strict=True):
        sheet.text(at, box.y0 - 2.0 * _TICK, label, ha="center", va="top")
    for at, label in zip(y, y_ticks.labels, strict=True):
        sheet.text(box.x0 - 2.0 * _TICK, at, label, ha="right", va="center_baseline")
    sheet.text(0.5 * (box.x0 + box.x1), box.y0 - _X_LABEL, panel.x_label, ha="center", va="top")
    widest = max((text_width(label, 9.0) for label in y_ticks.labels), default=0.0)
    label_at = max(_LINE, box.x0 - 2.0 * _TICK - widest - 4.0 * POINT)
    sheet.text(label_at, 0.5 * (box.y0 + box.y1), panel.y_label, turned=True, ha="right", va="center")
    sheet.text(box.x1, box.y0 - _X_LABEL, x_ticks.offset, ha="right", va="top")
    sheet.text(box.x0 - 4.0 * POINT, box.y1 + 3.0 * POINT, y_ticks.offset, _SMALL, ha="right")


def _draw_mark(panel: Panel, mark: Mark, sheet: Sheet, axes: tuple[Axis, Axis], box: Bbox, most: int) -> None:
    x_axis, y_axis = axes
    if isinstance(mark, Level):
        at = float((x_axis if mark.upright else y_axis).place([mark.at])[0])
        ends = [(at, at), (box.y0, box.y1)] if mark.upright else [(box.x0, box.x1), (at, at)]
        sheet.line(np.array(ends[0]), np.array(ends[1]), box, **_line(mark))
    elif isinstance(mark, Band):
        sheet.area(_outlines(x_axis.place(mark.x), y_axis, mark), mark.colour, box, _BAND_ALPHA)
    elif isinstance(mark, Dots):
        x, y = x_axis.place(mark.x), y_axis.place(mark.y)
        if mark.error is not None:
            low, high = y_axis.place(mark.y - mark.error), y_axis.place(mark.y + mark.error)
            sheet.segments(np.column_stack([x, low, x, high]).reshape(-1, 2, 2), mark.colour, _BAR, box)
        sheet.line(x, y, box, **_dots(mark))
    else:
        shown = mark if mark.dots else simplified(panel, mark, most, most // 2, _CANVAS)
        if isinstance(shown, Extent):
            x = x_axis.place(shown.edges)
            # A slope from one middle to the next takes half as many points as steps.
            x[1:-2] = 0.5 * (x[1:-2] + x[2:-1])
            sheet.area(_outlines(np.delete(x, -2), y_axis, shown), mark.colour, box, edge=mark.width)
            return
        markers = _MARKER if mark.dots else {}
        sheet.line(x_axis.place(shown.x), y_axis.place(shown.y), box, **_line(mark), **markers)


def _outlines(x: Array, y_axis: Axis, area: Band | Extent) -> list[Array]:
    """Return the outlines on the sheet of what lies between two curves, one for each part without a gap."""
    low, high = y_axis.place(area.low), y_axis.place(area.high)
    known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
    parts = [part for part in np.split(np.arange(len(x)), np.flatnonzero(~known)) if known[part].any()]
    parts = [part[known[part]] for part in parts]
    return [np.column_stack([np.append(x[k], x[k][::-1]), np.append(low[k], high[k][::-1])]) for k in parts]


def _line(mark: Curve | Level) -> Any:
    width = mark.width if isinstance(mark, Curve) else 0.7
    return {"color": mark.colour, "linewidth": width, "linestyle": mark.dash}


def _dots(mark: Dots) -> Any:
    return {"color": mark.colour, "linestyle": "", "marker": ".", "markersize": 5.0 if mark.error is None else 4.0}
