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


def record_type(*fields: Any, **numbers: int | tuple[int, ...]) -> np.dtype[np.void]:
    """Return the type of a record as compiled code reads it, aligned.

    Args:
        fields: as NumPy has them; they come first.
        numbers: shapes of the float64 arrays behind them, by name; a single number is a length.
    """
    shapes = {name: (n,) if isinstance(n, int) else n for name, n in numbers.items()}
    arrays = [(name, np.float64, shape) for name, shape in shapes.items()]
    return np.dtype([*fields, *arrays], align=True)


def array_digest(*arrays: NDArray[Any] | None) -> str:
    """Return a digest of arrays, 32 characters; None and an empty array differ, 0 and -0 do not."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(
            b"none" if array is None else repr(array.shape).encode() + (array + 0).tobytes()
        )
    return digest.hexdigest()[:32]


def vectors(size: int, *names: str) -> list[tuple[str, type[np.float64], tuple[int]]]:
    """Return the fields of a structured type that are vectors of numbers, shape (size,)."""
    return [(name, np.float64, (size,)) for name in names]
