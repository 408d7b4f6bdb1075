"""Pair the messages of two series that have the same stamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries

_KEY = np.dtype([("stamp", np.int64), ("occurrence", np.int64)])


@dataclass(frozen=True)
class Side:
    """What one of two series has and the other lacks, or has twice.

    Attributes:
        missing: stamps inside the common range that the other one lacks.
        first_missing_ns: the first of them.
        outside: messages before or after the common range.
        repeats: exact repetitions of a message, which were dropped.
        ambiguous: messages whose stamp an earlier one with other content has.
    """

    missing: int
    first_missing_ns: int | None
    outside: int
    repeats: int
    ambiguous: int


@dataclass(frozen=True, eq=False)
class Alignment:
    """Pairs of rows with equal stamps, in their order; `range_ns` is the stamps' common range, if any."""

    rows_a: NDArray[np.intp]
    rows_b: NDArray[np.intp]
    stamp_ns: Int64Array
    range_ns: tuple[int, int] | None
    a: Side
    b: Side


@dataclass(frozen=True, eq=False)
class _Keyed:
    """The rows of a series that are no repetitions, by stamp, numbered among those with the same stamp."""

    rows: NDArray[np.intp]
    stamp: Int64Array
    occurrence: Int64Array
    repeats: int


def align(a: JointSeries, b: JointSeries) -> Alignment:
    """Pair the messages of two series by stamp.

    Several messages with one stamp: exact repetitions count once; different ones are paired in their order,
    the first with the first and so on.
    """
    keyed_a, keyed_b = _key(a), _key(b)
    rows_a, rows_b = _intersect(keyed_a, keyed_b)
    common = None
    if len(keyed_a.stamp) and len(keyed_b.stamp):
        low = max(int(keyed_a.stamp[0]), int(keyed_b.stamp[0]))
        high = min(int(keyed_a.stamp[-1]), int(keyed_b.stamp[-1]))
        common = (low, high) if low <= high else None
    return Alignment(
        keyed_a.rows[rows_a],
        keyed_b.rows[rows_b],
        keyed_a.stamp[rows_a],
        common,
        _side(keyed_a, rows_a, common),
        _side(keyed_b, rows_b, common),
    )


def _key(series: JointSeries) -> _Keyed:
    rows = np.argsort(series.stamp_ns, kind="stable")
    stamp = series.stamp_ns[rows]
    occurrence = np.zeros(len(rows), dtype=np.int64)
    keep = np.ones(len(rows), dtype=np.bool_)
    again = np.flatnonzero(stamp[1:] == stamp[:-1]) + 1
    seen: dict[bytes, int] = {}
    last = -1
    for i in again.tolist():
        if i - 1 != last:  # a new group begins with the message before
            seen = {_content(series, int(rows[i - 1])): 0}
        last = i
        content = _content(series, int(rows[i]))
        keep[i] = content not in seen
        occurrence[i] = seen.setdefault(content, len(seen))
    return _Keyed(rows[keep], stamp[keep], occurrence[keep], int(len(rows) - keep.sum()))


def _content(series: JointSeries, row: int) -> bytes:
    return b"".join(values[row].tobytes() for values in series.fields.values())


def _intersect(a: _Keyed, b: _Keyed) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    keys_a: NDArray[Any] = a.stamp
    keys_b: NDArray[Any] = b.stamp
    if a.occurrence.any() or b.occurrence.any():
        keys_a, keys_b = _pairs(a), _pairs(b)
    _, rows_a, rows_b = np.intersect1d(keys_a, keys_b, assume_unique=True, return_indices=True)
    return rows_a, rows_b


def _pairs(keyed: _Keyed) -> NDArray[np.void]:
    keys = np.zeros(len(keyed.stamp), dtype=_KEY)
    keys["stamp"], keys["occurrence"] = keyed.stamp, keyed.occurrence
    return keys


def _side(keyed: _Keyed, matched: NDArray[np.intp], common: tuple[int, int] | None) -> Side:
    inside = np.zeros(len(keyed.stamp), dtype=np.bool_)
    if common is not None:
        inside = (keyed.stamp >= common[0]) & (keyed.stamp <= common[1])
    missing = inside.copy()
    missing[matched] = False
    stamps = keyed.stamp[missing]
    return Side(
        missing=len(stamps),
        first_missing_ns=int(stamps[0]) if len(stamps) else None,
        outside=int(len(inside) - inside.sum()),
        repeats=keyed.repeats,
        ambiguous=int((keyed.occurrence > 0).sum()),
    )
