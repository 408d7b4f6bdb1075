"""Long lines with few points."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array, Index


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
