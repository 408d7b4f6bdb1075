"""Short names for types of arrays, whose shapes docstrings state, and how long they may be."""

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
RecordType = np.dtype[np.void]


def record_type(*fields: Any, **contents: Any) -> RecordType:
    """Return the type of a record as compiled code reads it, aligned.

    Args:
        fields: as NumPy has them; they come first.
        contents: what lies behind them, by name: a type, or the shape of float64 numbers; a single number is a length,
            () the shape of one number.
    """
    shapes = {name: (n,) if isinstance(n, int) else n for name, n in contents.items()}
    named = [
        (name, np.float64, shape) if isinstance(shape, tuple) else (name, shape)
        for name, shape in shapes.items()
    ]
    return np.dtype([*fields, *named], align=True)


def rms(values: Array) -> float:
    """Return the root mean square of all numbers of an array."""
    return float(np.sqrt(np.mean(np.square(values))))


def column_rms(values: Array) -> Array:
    """Return the root mean square of each column, shape (..., n), of an array of shape (m, ..., n)."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def interpolated(at: Array, times: NDArray[np.floating[Any]], values: Array) -> Array:
    """Return columns of values, given at times, at others, shape (m, n); the ends hold beyond them."""
    return np.column_stack([np.interp(at, times, column) for column in values.T])


def array_digest(*arrays: NDArray[Any] | None) -> str:
    """Return a digest of arrays, 32 characters; None and an empty array differ, 0 and -0 do not."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(
            b"none" if array is None else repr(array.shape).encode() + (array + 0).tobytes()
        )
    return digest.hexdigest()[:32]
