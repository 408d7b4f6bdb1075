"""Least and largest values of neighbouring rows: what of a long curve is seen in a narrow place."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array, Index


def least_and_largest(values: Array, starts: Index) -> tuple[Array, Array]:
    """Return the extremes of groups of rows, each shape (m, ...), NaN where a group holds nothing else.

    Args:
        values: shape (n, ...).
        starts: first row of each group, which ends before the next one or at the end; increasing, shape (m,).
    """
    return np.fmin.reduceat(values, starts, axis=0), np.fmax.reduceat(values, starts, axis=0)
