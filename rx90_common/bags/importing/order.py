"""Rows whose times do not lie between those around them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Container, Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from rx90_common.bags.importing.spool import RowSpool, SpooledRows
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS


class RowFault(NamedTuple):
    """Number of a row's line in the log, and what is wrong with the row."""

    line: int
    reason: str


class _Row(NamedTuple):
    number: int
    stamp_ns: int
    line: int


def disordered(spool: RowSpool, faults: Container[int], seconds: Fraction) -> dict[int, RowFault]:
    """Return the fewest rows without which all times increase.

    Memory is needed for the longest run of rows in which times overlap, not for all of them: a time that is larger than
    all before it and smaller than all behind it stays, and what lies on either side of it can be looked at by itself.

    Args:
        spool: the rows.
        faults: numbers of rows that are left out anyway.
        seconds: of the log's unit of time.
    """
    smallest_behind: list[int | None] = []
    behind: int | None = None
    for block in spool.blocks(backwards=True):
        smallest_behind.append(behind)
        stamps = block.stamp_ns[_good(block, faults)]
        if len(stamps):
            behind = int(stamps.min()) if behind is None else min(behind, int(stamps.min()))
    found: dict[int, RowFault] = {}
    for run in _overlapping(spool, faults, smallest_behind[::-1]):
        kept = set(_increasing([row.stamp_ns for row in run]))
        for k, row in enumerate(run):
            if k not in kept:
                time = Decimal(row.stamp_ns) * seconds.denominator / (NANOSECONDS * seconds.numerator)
                found[row.number] = RowFault(
                    row.line, f"time {quoted(f'{time:f}')} does not lie between those around it"
                )
    return found


def _good(block: SpooledRows, faults: Container[int]) -> list[int]:
    return [k for k in range(len(block.stamp_ns)) if block.first + k not in faults]


def _overlapping(spool: RowSpool, faults: Container[int], behind: Sequence[int | None]) -> Iterator[list[_Row]]:
    """Yield each run of rows none of which is larger than all before it and smaller than all behind it."""
    run: list[_Row] = []
    largest = -1  # of the stamps so far
    for block, after in zip(spool.blocks(), behind, strict=True):
        good = np.array(_good(block, faults), dtype=np.intp)
        if not len(good):
            continue
        stamps = block.stamp_ns[good]
        before = np.maximum.accumulate(np.concatenate([[largest], stamps[:-1]]))
        last = np.iinfo(np.int64).max if after is None else after
        least = np.minimum.accumulate(np.concatenate([stamps[1:], [last]])[::-1])[::-1]
        in_place = (before < stamps) & (stamps < least)
        largest = max(largest, int(stamps.max()))
        if in_place.all() and not run:
            continue
        for at, stays in zip(good.tolist(), in_place.tolist(), strict=True):
            if not stays or run:
                run.append(_Row(block.first + at, int(block.stamp_ns[at]), int(block.line[at])))
            if stays and run:  # it belongs to the run: the steps up to it are to be short
                yield run
                run = []
    if run:
        yield run


def _increasing(values: Sequence[int]) -> list[int]:
    """Return the indices of the longest strictly increasing subsequence, of several the one with the shortest steps."""
    piles: list[list[int]] = []  # of indices; in a pile the values decrease
    smallest: list[int] = []  # last value of each pile
    for k, value in enumerate(values):
        pile = bisect_left(smallest, value)
        if pile == len(piles):
            piles.append([])
            smallest.append(value)
        piles[pile].append(k)
        smallest[pile] = value
    chosen: list[int] = []
    for members in reversed(piles):
        if not chosen:
            chosen.append(members[-1])
            continue
        # Of those that come before the one behind, the largest smaller value: the first such in the pile.
        before = members[: bisect_left(members, chosen[-1])]
        chosen.append(before[bisect_right(before, -values[chosen[-1]], key=lambda k: -values[k])])
    return chosen[::-1]
