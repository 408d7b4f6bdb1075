"""Curves of millions of points, reduced to those that are seen, before anything else is done with them.

Of the points that lie beside each other in a column narrower than a dot the first, the least, the largest and the last
are kept: lines through these cover the same dots as lines through all (M4 of Jugel et al., Proc. VLDB Endowment 7
(2014) 797).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.base.extremes import least_and_largest
from rx90_common.report.plot import Curve, Heat, Mark, Panel, Plot, on_axis

_COLUMNS = 8000  # two for each dot of the widest canvas that a curve is simplified on
_LONG = 8 * _COLUMNS  # points; of a shorter curve four in a column would not be much fewer


def thinned(plot: Plot) -> Plot:
    """Return a plot that looks the same, with long curves reduced; curves with dots keep every point."""
    panels = [
        panel if isinstance(panel, Heat) else replace(panel, marks=[_thinned(panel, mark) for mark in panel.marks])
        for panel in plot.panels
    ]
    return replace(plot, panels=panels)


def _thinned(panel: Panel, mark: Mark) -> Mark:
    if not isinstance(mark, Curve) or mark.dots or len(mark.x) <= _LONG:
        return mark
    x = on_axis(mark.x, panel.x_scale, panel.smallest)
    rows = _rows_seen(x, np.ascontiguousarray(on_axis(mark.y, panel.y_scale, panel.smallest)))
    return replace(mark, x=mark.x[rows], y=mark.y[rows])


def _rows_seen(x: Array, y: Array) -> Index:
    """Return the rows of a curve that are kept, increasing; of those without a value the ends of each gap."""
    known = np.isfinite(x) & np.isfinite(y)
    low, high = (x[known].min(), x[known].max()) if known.any() else (0.0, 0.0)
    place = np.where(known, x - low, 0.0) * (_COLUMNS / (high - low) if high > low else 0.0)
    column = np.where(known, place.astype(np.int32), -1)
    starts = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    lengths = np.diff(np.append(starts, len(x)))
    filled = starts[known[starts]]
    rows = [starts, starts + lengths - 1]
    for extreme in least_and_largest(y, starts):
        equal = np.flatnonzero(y == np.repeat(extreme, lengths))
        rows.append(equal[np.searchsorted(equal, filled)])
    return np.unique(np.concatenate(rows))
