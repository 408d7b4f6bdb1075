"""Correlations as a picture: a square of colours with the names beside it, and what the colours mean."""

from __future__ import annotations

import numpy as np
from matplotlib.transforms import Bbox

from rx90_common.report.plot import Heat
from rx90_common.report.sheet import POINT, Sheet, text_width

_COLOURS = "RdBu_r"
_SCALE = 0.75  # inches on the right, for what the colours mean
_TITLE = 0.3
_MARGIN = 0.08


def draw_heat(heat: Heat, sheet: Sheet, place: Bbox) -> None:
    """Draw correlations into a place on the sheet."""
    count = len(heat.names)
    size = max(3.5, min(9.0, 330.0 / max(1, count)))
    names = max((text_width(name, size) for name in heat.names), default=0.0) + 3.5 * POINT + _MARGIN
    side = min(place.width - names - _SCALE, place.height - names - _TITLE)
    left = place.x0 + names + 0.5 * (place.width - names - _SCALE - side)
    box = Bbox.from_bounds(left, place.y0 + names, side, side)
    sheet.image(box, heat.values, _COLOURS)
    sheet.box(box, "black", 0.8)
    sheet.text(box.x0, box.y1 + 6.0 * POINT, heat.title)
    cell = side / max(1, count)
    for k, name in enumerate(heat.names):
        at = (k + 0.5) * cell
        sheet.text(box.x0 + at, box.y0 - 3.5 * POINT, name, size, turned=True, ha="center", va="top")
        sheet.text(box.x0 - 3.5 * POINT, box.y1 - at, name, size, ha="right", va="center_baseline")
    if count <= 12:  # the figures have room in their squares
        _write_values(heat, sheet, box, cell)
    _draw_scale(sheet, box)


def _write_values(heat: Heat, sheet: Sheet, box: Bbox, cell: float) -> None:
    size = min(6.0, 0.4 * cell / POINT)  # four figures and a sign
    for (i, j), value in np.ndenumerate(heat.values):
        if np.isfinite(value):
            words = f"{value:.2f}".replace("-0.00", "0.00")
            shade = "white" if abs(value) > 0.6 else "black"
            x, y = box.x0 + (j + 0.5) * cell, box.y1 - (i + 0.5) * cell
            sheet.text(x, y, words, size, ha="center", va="center_baseline", color=shade)


def _draw_scale(sheet: Sheet, box: Bbox) -> None:
    scale = Bbox.from_bounds(box.x1 + 0.2, box.y0 + 0.2 * box.height, 0.03 * box.height + 0.03, 0.6 * box.height)
    sheet.image(scale, np.linspace(1.0, -1.0, 64)[:, None], _COLOURS)
    sheet.box(scale, "black", 0.8)
    for value, label in ((-1, "\N{MINUS SIGN}1"), (0, "0"), (1, "1")):
        at = scale.y0 + 0.5 * (value + 1) * scale.height
        sheet.text(scale.x1 + 5.0 * POINT, at, label, ha="left", va="center_baseline")
    sheet.text(scale.x1 + 18.0 * POINT, 0.5 * (scale.y0 + scale.y1), "correlation", turned=True, va="center")
