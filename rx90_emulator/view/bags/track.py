"""A recorded series that can be asked for any time: between its samples, and, for plots, for its extremes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.base.arrays import Array
from rx90_common.base.extremes import least_and_largest

_GAP = 3.5  # times the median interval: fewer than three messages that are missing are interpolated
_BLOCK = 1 << 14  # samples


@dataclass(frozen=True, eq=False)
class Track:
    """Values along time.

    Attributes:
        names: k of them.
        time_ns: increasing, int64 of shape (n,).
        values: by field, float64 of shape (n, k).
        gap_ns: an interval longer than this is a gap, in which nothing is known.
        units: of the fields.
    """

    names: tuple[str, ...]
    time_ns: Int64Array
    values: dict[str, Array]
    gap_ns: int
    units: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, series: JointSeries) -> tuple[Track, int]:
        """Return a series put in order of time, and how often its time goes back as after a reset.

        Of messages with one stamp the first counts. Where time goes back by more than a gap, two runs would be mixed:
        what comes after the last such place is returned.
        """
        stamps = series.stamp_ns
        steps = np.diff(stamps)
        forward = steps[steps > 0]
        gap_ns = int(_GAP * np.median(forward)) if len(forward) else 0
        back = np.flatnonzero(steps < -gap_ns)
        begin = int(back[-1]) + 1 if len(back) else 0
        if (steps[begin:] > 0).all():
            series = series.take(slice(begin, None)) if begin else series
        else:
            _, first = np.unique(stamps[begin:], return_index=True)
            series = series.take(begin + first)
        return cls(series.names, series.stamp_ns, dict(series.fields), gap_ns, series.units), len(back)

    @property
    def begin_ns(self) -> int:
        """Return the first time."""
        return int(self.time_ns[0])

    @property
    def end_ns(self) -> int:
        """Return the last time."""
        return int(self.time_ns[-1])

    def moved(self, by_ns: int) -> Track:
        """Return the same values at times that are later by `by_ns`."""
        return replace(self, time_ns=self.time_ns + by_ns) if by_ns else self

    def gaps(self) -> NDArray[np.int64]:
        """Return the last time before and the first one after each gap, shape (m, 2)."""
        rows = np.flatnonzero(np.diff(self.time_ns) > self.gap_ns)
        return np.stack([self.time_ns[rows], self.time_ns[rows + 1]], axis=1)

    def at(self, field: str, time_ns: Int64Array) -> Array:
        """Return a field at any times, shape (m, k): a sample as it is, between two samples the line between them.

        NaN in gaps, before the first sample and after the last one.
        """
        wanted = np.asarray(time_ns, dtype=np.int64)
        values, last = self.values[field], len(self.time_ns) - 1
        before = np.clip(np.searchsorted(self.time_ns, wanted, side="right") - 1, 0, last)
        after = np.minimum(before + 1, last)
        since, step = wanted - self.time_ns[before], self.time_ns[after] - self.time_ns[before]
        between = (since > 0) & (since < step) & (step <= self.gap_ns)
        share = np.where(between, since / np.maximum(step, 1), 0.0)[:, None]
        low = values[before]
        with np.errstate(invalid="ignore"):
            found = np.where(share > 0.0, low + share * (values[after] - low), low)
        found[~(between | (since == 0))] = np.nan
        return found

    def envelope(self, field: str, begin_ns: int, end_ns: int, buckets: int) -> tuple[Int64Array, Array]:
        """Return at most 2 `buckets` points of a curve in which every peak stands, however many samples there are.

        The time is cut into equal buckets; each gives its least and its largest value, samples inside it and the line
        at its edges alike, at its beginning and its end. A sample therefore stands up to one bucket beside its time.

        Args:
            field: of the values.
            begin_ns: of the curve.
            end_ns: of the curve, after its beginning.
            buckets: how many, at least 1.

        Returns:
            Times, shape (2 m,), and values, shape (2 m, k), NaN where nothing is known; m is `buckets`, or less where
            buckets would be shorter than 2 ns.
        """
        count = max(1, min(buckets, (end_ns - begin_ns) // 2))
        edges = begin_ns + ((end_ns - begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
        edge_values = self.at(field, edges)
        rising = edge_values[1:] >= edge_values[:-1]
        least, largest = np.fmin(edge_values[1:], edge_values[:-1]), np.fmax(edge_values[1:], edge_values[:-1])
        rows = np.searchsorted(self.time_ns, edges)
        filled = np.flatnonzero(np.diff(rows))
        if len(filled):
            inside, starts = self.values[field][: rows[-1]], rows[filled]
            lowest, highest = least_and_largest(inside, starts)
            least[filled], largest[filled] = np.fmin(least[filled], lowest), np.fmax(largest[filled], highest)
        time = np.stack([edges[:-1], edges[1:] - 1], axis=1).reshape(-1)
        ends = [np.where(rising, least, largest), np.where(rising, largest, least)]
        return time, np.stack(ends, axis=1).reshape(2 * count, -1)


def blocks(count: int) -> Iterator[slice]:
    """Yield the rows of `count` samples in pieces, for what would take too much memory for all of them at once."""
    return (slice(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK))
