"""The HTML page of every report: one frame with the style, and plots in it, as pictures and for zooming.

The page contains BokehJS and each plot as Bokeh's own JSON, which `page.html.j2` embeds when it comes near the window.
Without scripts, and on paper, the pictures are shown.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import gridplot
from bokeh.models import FixedTicker, HoverTool, PlainText, Range1d
from bokeh.models.annotations import Title
from bokeh.palettes import RdBu11, interp_palette
from bokeh.plotting import ColumnDataSource, figure
from bokeh.resources import INLINE
from bokeh.transform import linear_cmap
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup

from rx90_common.base.arrays import Array
from rx90_common.base.share import share_directory
from rx90_common.report.picture import as_svg, log_ticks
from rx90_common.report.plot import (
    Band,
    Curve,
    Dots,
    Heat,
    Level,
    Mark,
    Panel,
    Plot,
    symlog,
    symlog_ticks,
    with_fewer_points,
)

# in all curves of a page: about 900 and 500 KB
_POINTS_TO_ZOOM = 80_000
_POINTS_OF_PICTURES = 40_000
_POINTS_A_CURVE = 100  # whose data have as many bytes as Bokeh's description of a curve
_MIN_POINTS = 40  # of a curve
_MAX_POINTS = 8000  # of a curve
_DOTS_PER_INCH = 96
_EXACT = 0.01  # least variation of a curve, as a share of its size, for which single precision is enough to zoom in
_PLACE = "<!--plot {}-->"  # text from outside is escaped, so that nobody else writes it
_TERMS = "<!--terms-->"
_PRINTF = "{%.6g}"


@cache
def _environment(package: str) -> Environment:
    loaders = [PackageLoader(package), PackageLoader("rx90_common.report")]
    return Environment(loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True)


@cache
def _terms() -> Markup:
    """Return the documentation's glossary and works as HTML; their links to other pages become text."""
    text = (share_directory() / "docs/reference/glossary_and_works.md").read_text(encoding="utf-8")
    text = re.sub(r"\[([^]]*)\]\((?!https:)[^)]*\)", r"\1", text.partition("\n## ")[2])
    return Markup(MarkdownIt("commonmark").enable("table").render("## " + text))


def render_page(package: str, template: str, words: Callable[[str], str] = str, **values: object) -> str:
    """Return a self-contained HTML page. In a template, `draw(plot)` inserts a plot: as a picture, and for zooming.

    Args:
        package: the package whose folder `templates` holds the template.
        template: its file, which extends `page.html.j2` and fills the blocks title, summary and content.
        words: changes the page's text and the labels of its plots, such as their units.
        values: for the names in the template; a missing name is an error.
    """
    plots: list[Plot] = []

    def draw(plot: Plot) -> Markup:
        """Return the placeholder of a plot until all plots, which share the page's size, are known."""
        plots.append(plot.worded(words))
        return Markup(_PLACE.format(len(plots) - 1))

    def bokeh_script() -> Markup:
        return Markup(INLINE.js_raw[0].replace("</script>", "<\\/script>")) if plots else Markup()

    known = values | {"draw": draw, "bokeh_script": bokeh_script}
    page = _environment(package).get_template(template).render(known)
    pieces = re.split(r"(<(?:script|style)\b.*?</(?:script|style)>)", page, flags=re.DOTALL)
    page = "".join(piece if piece.startswith(("<script", "<style")) else words(piece) for piece in pieces)
    page = page.replace(_TERMS, _terms())
    if not plots:
        return page
    lengths = [len(mark.x) for plot in plots for panel in plot.panels if isinstance(panel, Panel)
               for mark in panel.marks if isinstance(mark, Curve)]  # fmt: skip
    to_zoom = _share(lengths, _POINTS_TO_ZOOM - _POINTS_A_CURVE * len(lengths))
    of_picture = _share(lengths, _POINTS_OF_PICTURES)
    elements = []
    for plot in plots:
        legend: dict[str, Mark] = {}
        for mark in (mark for panel in plot.panels if isinstance(panel, Panel) for mark in panel.marks if mark.label):
            legend.setdefault(mark.label, mark)
        parts = {"picture": as_svg(plot, of_picture), "json": plot_json(with_fewer_points(plot, to_zoom))}
        shown = {name: Markup(text) for name, text in parts.items()}
        template_of_plot = _environment("rx90_common.report").get_template("plot.html.j2")
        elements.append(template_of_plot.render(shown, legend=legend))
    if max(lengths, default=0) > to_zoom:
        note = f"Of long curves the first, least, largest and last value in each of {to_zoom // 4} parts are shown."
        page = page.replace("<footer>", f"<footer>{note} ", 1)
    return re.sub(_PLACE.format(r"(\d+)"), lambda place: elements[int(place[1])], page)


def _share(lengths: Sequence[int], together: int) -> int:
    """Return how many points each curve may have; curves that have fewer leave the rest to the others."""
    sizes = sorted(lengths)
    for k, size in enumerate(sizes):
        share = together // (len(sizes) - k)
        if size > share:
            return min(max(share, _MIN_POINTS), _MAX_POINTS)
        together -= size
    return _MAX_POINTS


def plot_json(plot: Plot) -> str:
    """Return the plot as Bokeh's JSON for a <script> element; equal plots give equal text."""
    share = _range(plot.x_range) if plot.share_x else None
    height = round(plot.height * _DOTS_PER_INCH)
    figures = [_heat(one) if isinstance(one, Heat) else _panel(one, height, share) for one in plot.panels]
    grid = gridplot(figures, ncols=plot.columns, sizing_mode="stretch_width", toolbar_options={"logo": None})
    text = json.dumps(json_item(grid), allow_nan=False, separators=(",", ":"))
    # Bokeh counts its models through the whole process, and gives each embedding a name by chance.
    names: dict[str, str] = {}
    text = re.sub(r'(id":)"([^"]+)"', lambda found: f'{found[1]}"{names.setdefault(found[2], f"m{len(names)}")}"', text)
    return text.replace("<", "\\u003c")


def _range(ends: Sequence[float] | Array) -> Range1d:
    return Range1d(start=float(ends[0]), end=float(ends[1]))


def _figure(title: str, **options: Any) -> Any:
    shown = figure(
        tools="box_zoom,pan,wheel_zoom,reset", active_drag="box_zoom", active_scroll=None, min_border_right=12,
        sizing_mode="stretch_width", outline_line_color=None, **options,
    )  # fmt: skip
    font = "system-ui, sans-serif"
    text = PlainText(text=title)  # dollars in a name from outside make no formula
    shown.title = Title(text=text, visible=bool(title), text_font=font, text_font_size="13px", text_font_style="normal")
    for axis in shown.axis:
        axis.update(
            axis_label_text_font=font, axis_label_text_font_size="13px", axis_label_text_font_style="normal",
            major_label_text_font=font, major_label_text_font_size="12px", axis_line_color="#555555",
            major_tick_line_color="#555555", minor_tick_line_color=None,
        )  # fmt: skip
    shown.grid.grid_line_color = "#e3e6e9"
    return shown


def _panel(panel: Panel, height: int, share: Range1d | None) -> Any:
    is_symlog = panel.x_scale == "symlog"  # Bokeh has no such axis: its decades are shown on a linear one
    ends = np.array(panel.x_range)
    shown = _figure(
        height=height + 16 * bool(panel.title) + 16 * bool(panel.x_label),
        title=panel.title, x_axis_label=PlainText(text=panel.x_label), y_axis_label=PlainText(text=panel.y_label),
        x_axis_type="linear" if is_symlog else panel.x_scale, y_axis_type=panel.y_scale,
        x_range=share or _range(symlog(ends, panel.smallest) if is_symlog else ends), y_range=_range(panel.y_range),
    )  # fmt: skip
    if is_symlog:
        ticks = symlog_ticks(*panel.x_range, panel.smallest)
        places = symlog(np.array(ticks), panel.smallest).tolist()
        shown.xaxis.ticker = FixedTicker(ticks=places)
        shown.xaxis.major_label_overrides = {place: f"{tick:g}" for place, tick in zip(places, ticks, strict=True)}
    elif panel.x_scale == "log" and (few := log_ticks(*panel.x_range)):
        shown.xaxis.ticker = FixedTicker(ticks=few)
    hovered = [renderer for mark in panel.marks for renderer in _draw_mark(shown, panel, mark)]
    labels = [("", "$name"), (panel.x_label or "x", "@x" + _PRINTF), (panel.y_label or "y", "@y" + _PRINTF)]
    formatters: Any = {"@x": "printf", "@y": "printf"}
    shown.add_tools(HoverTool(renderers=hovered, tooltips=labels, formatters=formatters, line_policy="nearest"))
    return shown


def _draw_mark(shown: Any, panel: Panel, mark: Mark) -> list[Any]:
    """Draw a mark, tagged with its label for the legend; return the renderers that show values under the pointer."""

    def place(x: Array) -> Array:
        return symlog(x, panel.smallest) if panel.x_scale == "symlog" else x

    look: Any = {"line_color": mark.colour, "line_width": 0.9, "tags": [mark.label]}
    if isinstance(mark, Curve | Level):
        look |= {"line_dash": mark.dash, "line_width": 1.3 * (mark.width if isinstance(mark, Curve) else 0.8)}
    if isinstance(mark, Level):
        at = float(place(np.array([mark.at]))[0]) if mark.upright else mark.at
        _ = shown.vspan(x=[at], **look) if mark.upright else shown.hspan(y=[at], **look)
        return []
    if isinstance(mark, Band):
        known = np.isfinite(mark.x) & np.isfinite(mark.low) & np.isfinite(mark.high)
        parts = [part[known[part]] for part in np.split(np.arange(len(known)), np.flatnonzero(~known))]
        x = place(mark.x)
        low = mark.low
        high = mark.high
        outlines = [(np.r_[x[k], x[k][::-1]], np.r_[low[k], high[k][::-1]]) for k in parts if len(k)]
        look |= {"line_color": None, "fill_color": mark.colour, "fill_alpha": 0.35}
        shown.patches([x.tolist() for x, _ in outlines], [y.tolist() for _, y in outlines], **look)
        return []
    source = ColumnDataSource({"x": _numbers(mark.x), "shown": _numbers(place(mark.x)), "y": _numbers(mark.y)})
    hovered = []
    if isinstance(mark, Curve):
        hovered.append(shown.line("shown", "y", source=source, name=mark.label, **look))
    elif mark.error is not None:
        shown.segment(place(mark.x), mark.y - mark.error, place(mark.x), mark.y + mark.error, **look)
    if isinstance(mark, Dots) or mark.dots:
        dots = {"fill_color": mark.colour, "line_color": None, "name": mark.label, "tags": [mark.label]}
        hovered.append(shown.scatter("shown", "y", source=source, size=5, **dots))
    return hovered


def _heat(heat: Heat) -> Any:
    count = len(heat.names)
    row, column = np.nonzero(np.isfinite(heat.values))
    names = np.array(heat.names)
    shown = _figure(
        title=heat.title, x_range=list(names), y_range=list(names[::-1]), aspect_ratio=1,
        max_width=900 if count > 12 else 420,
    )  # fmt: skip
    data = {"x": names[column].tolist(), "y": names[row].tolist(), "value": heat.values[row, column]}
    shown.rect("x", "y", 1, 1, source=ColumnDataSource(data), line_color=None,
               fill_color=linear_cmap("value", interp_palette(RdBu11, 256), -1.0, 1.0))  # fmt: skip
    shown.axis.major_label_overrides = {name: PlainText(text=name) for name in heat.names}
    shown.axis.major_label_text_font_size = f"{6 if count > 30 else 8 if count > 12 else 11}px"
    shown.xaxis.major_label_orientation = np.pi / 2.0
    shown.grid.grid_line_color = None
    tooltips = [("", "@y"), ("", "@x"), ("correlation", "@value" + _PRINTF)]
    shown.add_tools(HoverTool(tooltips=tooltips, formatters={"@value": "printf"}))
    return shown


def _numbers(values: Array) -> Any:
    """Return single precision where that is enough, which halves the page."""
    known = values[np.isfinite(values)]
    spread, size = (np.ptp(known), np.abs(known).max()) if len(known) else (0.0, 0.0)
    return values.astype(np.float32) if spread >= _EXACT * size and size < 1e30 else values
