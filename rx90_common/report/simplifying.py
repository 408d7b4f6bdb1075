"""Few points that look the same as a curve, or, of one that is too dense for a line through them, what it covers.

A line through too few points of a vibration would be a zigzag that is not there. What is there is an area: in each of
many columns from the least to the largest value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from matplotlib.path import Path

from rx90_common.base.arrays import Array
from rx90_common.base.extremes import least_and_largest
from rx90_common.report.plot import Curve, Panel, Plot, off_axis, on_axis

MOST_POINTS: Final = 4000
"""Of a curve that is drawn."""
_CANVAS = 4000.0, 2000.0  # dots of a panel that is zoomed in a few times
_FEWEST_POINTS = 4
_SMALLER = 0.7
_SMALLEST = 10.0  # dots; on fewer nothing is seen


@dataclass(frozen=True, eq=False)
class Extent:
    """What a curve covers in columns that are equally wide on the axis.

    Attributes:
        edges: of the columns, shape (n + 1,).
        low: least values, NaN where the curve has none, shape (n,).
        high: largest values, likewise.
    """

    edges: Array
    low: Array
    high: Array


def simplified(
    panel: Panel, curve: Curve, points: int, columns: int, canvas: tuple[float, float] = _CANVAS
) -> Curve | Extent:
    """Return fewer points of a curve that look the same in this panel, or its extent where that is the finer picture.

    The line through the points is right to a dot on a canvas of so many dots, or on the largest on which they are
    enough. If that has fewer dots than there are columns, these are returned, except of a curve that goes back.

    Args:
        panel: that the curve is drawn in.
        curve: without dots.
        points: of a line, at most; those of a curve that goes back and has many gaps may be more.
        columns: of an extent.
        canvas: width and height, dots.
    """
    values = _on_axes(panel, curve)
    has_columns = _goes_ahead(values[0])
    least = columns if has_columns else _SMALLEST
    steps = max(0, math.floor(math.log(least / canvas[0]) / math.log(_SMALLER)))
    canvases = [(canvas[0] * _SMALLER**k, canvas[1] * _SMALLER**k) for k in range(steps + 1)]
    if has_columns and len(_simplified(values, *canvases[-1])) > points:
        edges, *ends = _extent(*values, columns)
        low, high = (off_axis(end, panel.y_scale, panel.smallest) for end in ends)
        return Extent(off_axis(edges, panel.x_scale, panel.smallest), low, high)
    for one in canvases:
        found = _simplified(values, *one)
        if len(found) <= points:
            break
    x, y = found.T
    return replace(curve, x=off_axis(x, panel.x_scale, panel.smallest), y=off_axis(y, panel.y_scale, panel.smallest))


def points_needed(plots: Sequence[Plot]) -> list[int]:
    """Return how many points the curves of several plots need, MOST_POINTS at most."""
    panels = [panel for plot in plots for panel in plot.panels if isinstance(panel, Panel)]
    curves = [(panel, mark) for panel in panels for mark in panel.marks if isinstance(mark, Curve)]
    return [min(MOST_POINTS, len(_simplified(_on_axes(panel, curve), *_CANVAS))) for panel, curve in curves]


def share_of_points(needed: Sequence[int], together: int) -> int:
    """Return how many points each curve may have, so that all have so many together at most.

    Who needs fewer leaves the rest to the others; a few points are given in any case.
    """
    sizes = sorted(needed)
    for k, size in enumerate(sizes):
        share = together // (len(sizes) - k)
        if size > share:
            return max(share, _FEWEST_POINTS)
        together -= size
    return MOST_POINTS


def _on_axes(panel: Panel, curve: Curve) -> tuple[Array, Array]:
    return on_axis(curve.x, panel.x_scale, panel.smallest), on_axis(curve.y, panel.y_scale, panel.smallest)


def _goes_ahead(x: Array) -> bool:
    return bool(len(x) > 1 and x[-1] > x[0] and (np.diff(x) >= 0.0).all())


def _extent(x: Array, y: Array, columns: int) -> tuple[Array, Array, Array]:
    """Return the edges of columns, and the least and largest value of the line in each, its ends included."""
    edges = np.linspace(x[0], x[-1], columns + 1)
    at_edges = np.interp(edges, x, y)
    first = np.searchsorted(x, edges[:-1])
    low, high = least_and_largest(np.insert(y, first, at_edges[:-1]), first + np.arange(columns))
    return edges, np.fmin(low, at_edges[1:]), np.fmax(high, at_edges[1:])


def _simplified(values: tuple[Array, Array], width: float, height: float) -> Array:
    """Return the points, shape (k, 2), with NaN where the curve has a gap."""
    ends = [(float(np.nanmin(v)), float(np.nanmax(v))) if np.isfinite(v).any() else (0.0, 0.0) for v in values]
    low = np.array([first for first, _ in ends])
    scale = np.array([s / (b - a) if b > a else 1.0 for (a, b), s in zip(ends, (width, height), strict=True)])
    path = Path((np.column_stack(values) - low) * scale)
    path.simplify_threshold = 0.5
    clean = path.cleaned(simplify=True, remove_nans=True)
    codes = np.asarray(clean.codes)
    points = np.asarray(clean.vertices)[codes != Path.STOP]
    starts = np.flatnonzero(codes[codes != Path.STOP] == Path.MOVETO)[1:]
    return np.asarray(np.insert(points, starts, np.nan, axis=0) / scale + low)
