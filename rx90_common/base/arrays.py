"""Short names for types of arrays, whose shapes docstrings state, how long they may be, and extremes of their rows."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_JOINTS = 7
"""Joints that an arm may have."""
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Record = NDArray[Any]
"""Of a structured type, as compiled code reads and changes it."""


def array_digest(*arrays: NDArray[Any] | None) -> str:
    """Return a digest of arrays, 32 characters; None and an empty array differ, 0 and -0 do not."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(b"none" if array is None else repr(array.shape).encode() + (array + 0).tobytes())
    return digest.hexdigest()[:32]


def least_and_largest(values: Array, starts: Index) -> tuple[Array, Array]:
    """Return the extremes of groups of rows, each shape (m, ...), NaN where a group holds nothing else.

    Args:
        values: shape (n, ...).
        starts: first row of each group, which ends before the next one or at the end; increasing, shape (m,).
    """
    return np.fmin.reduceat(values, starts, axis=0), np.fmax.reduceat(values, starts, axis=0)
