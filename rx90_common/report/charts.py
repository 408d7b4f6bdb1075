"""Bokeh figures for pages: their style, their legend, and long lines with few points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import HoverTool, Line, LogScale, PlainText, Scatter
from bokeh.models.annotations import Legend, LegendItem, Title
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure
from bokeh.themes import Theme

from rx90_common.base.arrays import Array, Index

MOST_POINTS = 80_000
"""In all lines of a page: about 1 MB."""
_FEWEST = 40  # points of a line
_FONT = "system-ui, sans-serif"
_TEXT = {"text_font": _FONT, "text_font_size": "13px", "text_font_style": "normal"}
_WRAPPED = """
.bk-grid { display: flex; flex-wrap: wrap; width: auto; gap: 0 0.9em; }
.bk-label { white-space: normal; }
"""
THEME = Theme(
    json={
        "attrs": {
            "Plot": {
                "sizing_mode": "stretch_width",
                "min_border_left": 72,  # of figures below each other the frames are, too
                "min_border_right": 12,
                "outline_line_color": None,
            },
            "Line": {"line_width": 1.3},
            "Toolbar": {"logo": None, "autohide": True},
            "DataRange1d": {"range_padding": 0.06},
            "Title": _TEXT,
            "Grid": {"grid_line_color": "#e3e6e9"},
            "Axis": {
                **{f"axis_label_{name}": value for name, value in _TEXT.items()},
                "major_label_text_font": _FONT,
                "major_label_text_font_size": "12px",
                "axis_line_color": "#555555",
                "major_tick_line_color": "#555555",
                "minor_tick_line_color": None,
            },
            "Legend": {
                "orientation": "horizontal",
                "location": "top_left",
                "click_policy": "hide",
                "label_text_font": _FONT,
                "border_line_color": None,
                "margin": 2,
                "stylesheets": [_WRAPPED],
            },
        }
    }
)


def inert(text: str) -> PlainText:
    """Return a text that is shown as it is: in a plain string Bokeh looks for TeX between dollar signs."""
    return PlainText(text=text)


def chart(
    title: str = "",
    x_label: str = "",
    y_label: str = "",
    *,
    height: int | None = 180,
    **options: Any,
) -> figure:
    """Return an empty figure.

    What is drawn in it with a `name` has an entry in the legend; lines and dots show their values below the pointer.

    Args:
        title: one line; "" for none.
        x_label: of the axis, with unit.
        y_label: of the axis, with unit.
        height: of the frame, pixels; None where options have another size.
        options: Bokeh's own.
    """
    empty = figure(
        title=Title(text=inert(title), visible=bool(title)),
        x_axis_label=inert(x_label),
        y_axis_label=inert(y_label),
        frame_height=height,
        tools="box_zoom,pan,wheel_zoom,reset",
        active_drag="box_zoom",
        active_scroll=None,
        **options,
    )
    labels = [("", "$name"), (x_label or "x", "@x{%.6g}"), (y_label or "y", "@y{%.6g}")]
    empty.add_tools(
        HoverTool(
            tooltips=labels,
            formatters={"@x": "printf", "@y": "printf"},
            renderers=[],
            visible=False,
        )
    )
    return empty


def stacked(
    names: Sequence[str],
    labels: tuple[str, str],
    x: Array,
    lines: Mapping[str, tuple[Array, dict[str, Any]]],
    across: int = 1,
) -> list[figure]:
    """Return a figure for each of n names, with the same lines over one x axis.

    Args:
        names: titles.
        labels: of the x axis and of the y axes, with units.
        x: shape (m,).
        lines: by their names, values of shape (m, n), and Bokeh's properties.
        across: how many figures stand side by side.
    """
    figures = []
    for k, name in enumerate(names):
        shown = chart(name, "", labels[1], height=120)
        for label, (values, style) in lines.items():
            shown.line(x, values[:, k], name=label, **style)
        figures.append(shown)
    over_one_x(figures, labels[0], across)
    return figures


def over_one_x(figures: Sequence[figure], x_label: str, across: int = 1) -> None:
    """Let figures show the same range of the x axis, with its label below the last, so many side by side."""
    for shown in figures[1:]:
        shown.x_range = figures[0].x_range
    for shown in figures[-across:]:
        shown.xaxis.axis_label = inert(x_label)


def _glyphs(shown: figure) -> list[GlyphRenderer[Any]]:
    return [renderer for renderer in shown.renderers if isinstance(renderer, GlyphRenderer)]


def join(figures: Sequence[figure]) -> None:
    """Give figures that are shown together one legend, each entry above the first that has it; a click hides it in all.

    What shows its value below the pointer is set, too.
    """
    named: dict[str, list[GlyphRenderer[Any]]] = {}
    for shown in figures:
        for renderer in _glyphs(shown):
            if renderer.name:
                named.setdefault(renderer.name, []).append(renderer)
        for tool in shown.hover:
            tool.renderers = [
                renderer
                for renderer in _glyphs(shown)
                if isinstance(renderer.glyph, Line | Scatter)
            ]
    for shown in figures:
        names = dict.fromkeys(renderer.name for renderer in _glyphs(shown))
        items = [
            LegendItem(label={"value": name}, renderers=named.pop(name))
            for name in names
            if name in named
        ]
        if items:
            shown.add_layout(Legend(items=items), "above")


def thin(figures: Sequence[figure]) -> int:
    """Leave about MOST_POINTS in the lines of figures; return how many a long line may have, 0 if none is long."""
    lines = [
        (renderer, isinstance(shown.x_scale, LogScale), isinstance(shown.y_scale, LogScale))
        for shown in figures
        for renderer in _glyphs(shown)
        if isinstance(renderer.glyph, Line)
    ]
    most = max(_FEWEST, MOST_POINTS // max(1, len(lines)))
    longest = 0
    for renderer, logarithmic_x, logarithmic_y in lines:
        source: Any = renderer.data_source
        x = source.data[renderer.glyph.x]
        y = source.data[renderer.glyph.y]
        longest = max(longest, len(x))
        if len(x) > most:
            # values without a logarithm are no points
            with np.errstate(divide="ignore", invalid="ignore"):
                rows = few_points(
                    np.log10(x) if logarithmic_x else x, np.log10(y) if logarithmic_y else y, most
                )
            source.data = {name: values[rows] for name, values in source.data.items()}
    return most if longest > most else 0


def few_points(x: Array, y: Array, most: int) -> Index:
    """Return the rows of about `most` points through which a line looks the same, in their order.

    The first, the least, the largest and the last of the points in each of most / 4 columns of equal width are kept:
    lines through these cover the same dots as lines through all, on a canvas with as many columns (M4 of Jugel et al.,
    Proc. VLDB Endowment 7 (2014) 797). A line that goes back in x keeps more.

    Args:
        x: shape (n,); logarithms for a logarithmic axis. Where it or `y` is no finite number the line has a gap.
        y: shape (n,).
        most: number of points.
    """
    if len(x) <= most:
        return np.arange(len(x))
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return np.array([0, len(x) - 1])
    low = x[known].min()
    width = (x[known].max() - low) / (most // 4)
    place = np.where(known, x - low, 0.0) / (width or 1.0)
    # a gap is a column of its own, whose ends are kept
    column = np.where(known, place.astype(np.int32), -1)
    run = np.cumsum(np.diff(column, prepend=column[0]) != 0)
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    ends = np.append(starts[1:], len(x)) - 1
    by_value = np.lexsort((y, run))
    return np.unique([starts, by_value[starts], by_value[ends], ends])
