"""Plots to be zoomed: what `templates/plots.js` draws them from, and BokehJS, which it draws them with.

Of the installed package bokeh nothing but BokehJS is used: what is to be zoomed is made in the page.
"""

from __future__ import annotations

import base64
import json
from functools import cache
from pathlib import Path
from typing import Any

import bokeh
import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.report.plot import (
    Band,
    Curve,
    Dots,
    Heat,
    Level,
    Mark,
    Panel,
    Plot,
    on_axis,
    symlog,
    symlog_ticks,
)
from rx90_common.report.simplifying import MOST_POINTS, Extent, simplified

_DOTS_PER_INCH = 96


# BokehJS comes with the package. It is imported with this module, because who needs a report must not learn at its end
# that it cannot be written.
_SCRIPTS = Path(bokeh.__file__).parent / "server" / "static" / "js"


@cache
def bokeh_scripts() -> tuple[str, ...]:
    """Return BokehJS and its interface for drawing, as they stand in a page."""
    texts = ((_SCRIPTS / name).read_text(encoding="utf-8") for name in ("bokeh.min.js", "bokeh-api.min.js"))
    return tuple(text.replace("</script>", "<\\/script>") for text in texts)


def plot_json(plot: Plot, most: int = MOST_POINTS) -> str:
    """Return what a plot holds, with up to `most` points or columns of a curve, as JSON for a <script> element."""
    content = {
        "columns": plot.columns,
        "share": list(plot.x_range) if plot.share_x else None,
        "height": round(plot.height * _DOTS_PER_INCH),
        "panels": [_heat(one) if isinstance(one, Heat) else _panel(one, most) for one in plot.panels],
    }
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _panel(panel: Panel, most: int) -> dict[str, Any]:
    content: dict[str, Any] = {
        "kind": "panel",
        "title": panel.title,
        "x_label": panel.x_label,
        "y_label": panel.y_label,
        "x_scale": panel.x_scale,
        "y_scale": panel.y_scale,
        "x_range": list(panel.x_range),
        "y_range": list(panel.y_range),
        "marks": [_mark(mark, panel, most) for mark in panel.marks],
    }
    if panel.x_scale == "symlog":  # BokehJS has no such axis: its decades are shown on a linear one
        ends = np.array(panel.x_range)
        ticks = symlog_ticks(*panel.x_range, panel.smallest)
        places = symlog(np.array(ticks), panel.smallest).tolist()
        content |= {
            "x_scale": "linear",
            "x_range": symlog(ends, panel.smallest).tolist(),
            "ticks": {"at": places, "labels": [f"{tick:g}" for tick in ticks]},
        }
    return content


def _mark(mark: Mark, panel: Panel, most: int) -> dict[str, Any]:
    content: dict[str, Any] = {"label": mark.label, "colour": mark.colour}
    if panel.x_scale == "symlog" and not isinstance(mark, Level):
        content["shown_x"] = _numbers(symlog(mark.x, panel.smallest))
    if isinstance(mark, Curve):
        shown = mark if mark.dots or "shown_x" in content else simplified(panel, mark, most, most)
        content |= {"width": mark.width, "dash": mark.dash}
        if isinstance(shown, Extent):
            return content | {"kind": "extent", "columns": _columns(panel, shown), "low": _numbers(shown.low),
                              "high": _numbers(shown.high)}  # fmt: skip
        return content | {"kind": "curve", "x": _numbers(shown.x), "y": _numbers(shown.y), "dots": mark.dots}
    if isinstance(mark, Dots):
        error = None if mark.error is None else _numbers(mark.error)
        return content | {"kind": "dots", "x": _numbers(mark.x), "y": _numbers(mark.y), "error": error}
    if isinstance(mark, Band):
        return content | {"kind": "band", "x": _numbers(mark.x), "low": _numbers(mark.low),
                          "high": _numbers(mark.high)}  # fmt: skip
    at = symlog(np.array([mark.at]), panel.smallest)[0] if mark.upright and panel.x_scale == "symlog" else mark.at
    return content | {"kind": "level", "at": float(at), "dash": mark.dash, "upright": mark.upright}


def _heat(heat: Heat) -> dict[str, Any]:
    values = [[None if np.isnan(value) else round(float(value), 4) for value in row] for row in heat.values]
    return {"kind": "heat", "title": heat.title, "names": list(heat.names), "values": values}


def _columns(panel: Panel, extent: Extent) -> dict[str, float]:
    """Return where on the axis the first column begins and the last one ends, and how many there are."""
    first, last = on_axis(extent.edges[[0, -1]], panel.x_scale, panel.smallest)
    return {"first": float(first), "last": float(last), "count": len(extent.low)}


def _numbers(values: Array) -> dict[str, Any]:
    """Return numbers in single precision about the middle of their range, which is enough to zoom in a lot."""
    values = np.asarray(values, dtype=np.float64)
    known = values[np.isfinite(values)]
    middle = 0.5 * (float(known.min()) + float(known.max())) if len(known) else 0.0
    data = base64.b64encode((values - middle).astype("<f4").tobytes()).decode("ascii")
    return {"middle": middle, "data": data}
