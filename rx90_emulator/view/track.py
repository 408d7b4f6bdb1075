"""Recorded series at any time, the difference of two, and the path error of one against its set-points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.base.arrays import Array, least_and_largest
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.chain import RigidChain
from rx90_common.description.kinematics import tip_position
from rx90_controller.lines.task import SETTLING

_AT_REST = 1e-4  # m/s, of the set-points: below it they have no direction of their own
PATH_ERROR = "path error"


def since(time_ns: int, origin_ns: int) -> float:
    """Return how long after the origin a stamp is, s: the time that the page shows."""
    return (time_ns - origin_ns) / NANOSECONDS


def seconds(time_ns: int) -> str:
    """Return a time in s, to the ms."""
    return f"{since(time_ns, 0):.3f}"


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


TIP = "tip"


class Worst(NamedTuple):
    """A largest absolute difference, with its sign, and its time."""

    value: float
    time_ns: int


@dataclass(frozen=True, eq=False)
class Difference:
    """The second recording less the first, at the stamps of the first that both cover.

    Attributes:
        joints: position, rad, of each joint; nothing in gaps of the second.
        tip: position, the distance of both tips, m, under the name TIP.
        exact: share of the stamps at which the second has a sample of its own; at the others the line between two is
            taken.
    """

    joints: Track
    tip: Track
    exact: float

    @property
    def worst_joints(self) -> tuple[Worst, ...]:
        """Return the largest difference of each joint."""
        return tuple(_worst(self.joints, column) for column in range(len(self.joints.names)))

    @property
    def worst_tip(self) -> Worst:
        """Return the largest distance of the tips."""
        return _worst(self.tip, 0)


def difference(first: Track, second: Track, chain: RigidChain, paths: tuple[Path, Path]) -> Difference:
    """Compare the positions of two tracks of one arm; the second's times are already moved to the first's.

    Raises:
        BagError: if they have no time in common outside of gaps.
    """
    begin, end = max(first.begin_ns, second.begin_ns), min(first.end_ns, second.end_ns)
    low, high = np.searchsorted(first.time_ns, begin), np.searchsorted(first.time_ns, end, side="right")
    time_ns = first.time_ns[low:high]
    joints, tip = np.empty((len(time_ns), len(first.names))), np.empty((len(time_ns), 1))
    for rows in blocks(len(time_ns)):
        one, other = first.values["position"][low:high][rows], second.at("position", time_ns[rows])
        joints[rows] = other - one
        tip[rows, 0] = np.linalg.norm(tip_position(chain, other) - tip_position(chain, one), axis=1)
    known = np.isfinite(tip[:, 0])
    if not known.any():
        spans = " and ".join(
            f"{plain(path)} from {seconds(track.begin_ns)} to {seconds(track.end_ns)} s"
            for path, track in zip(paths, (first, second), strict=True)
        )
        raise BagError(f"{spans} have no time in common; accepted: --align start, trajectory, or a time in s")
    if not known.all():
        time_ns, joints, tip = time_ns[known], joints[known], tip[known]
    exact = float(np.isin(time_ns, second.time_ns, assume_unique=True).mean())
    return Difference(
        Track(first.names, time_ns, {"position": joints}, first.gap_ns),
        Track((TIP,), time_ns, {"position": tip}, first.gap_ns),
        exact,
    )


def _worst(track: Track, column: int) -> Worst:
    values: Array = track.values["position"][:, column]
    row = int(np.argmax(np.abs(values)))
    return Worst(float(values[row]), int(track.time_ns[row]))


def path_error_track(arm: Track, reference: Track | None, chain: RigidChain) -> Track | None:
    """Return the distance of the tip from the path of its set-points under PATH_ERROR, m; None without set-points.

    It is the distance from the set-point of the same time, without its part along the path, which is the lag. It counts
    as `LineTask.counted` says of a line: while the set-points move and until the arm has settled, where their path has
    the direction of their last motion. Elsewhere it is NaN.
    """
    if reference is None:
        return None
    direction, counted = _directions(reference, chain)
    error = np.empty((len(arm.time_ns), 1))
    for rows in blocks(len(arm.time_ns)):
        time_ns = arm.time_ns[rows]
        target = tip_position(chain, reference.at("position", time_ns))
        off = tip_position(chain, arm.values["position"][rows]) - target
        place = np.searchsorted(reference.time_ns, time_ns, side="right") - 1
        across = off - np.sum(off * direction[place], axis=1)[:, None] * direction[place]
        error[rows, 0] = np.where(counted[place] & (place >= 0), np.linalg.norm(across, axis=1), np.nan)
    return Track((PATH_ERROR,), arm.time_ns, {"position": error}, arm.gap_ns)


def _directions(reference: Track, chain: RigidChain) -> tuple[Array, NDArray[np.bool_]]:
    """Return the direction of the path at each set-point, shape (n, 3), and whether its path error counts, (n,)."""
    count = len(reference.time_ns)
    tips = np.empty((count, 3))
    for rows in blocks(count):
        tips[rows] = tip_position(chain, reference.values["position"][rows])
    way = np.diff(tips, axis=0, append=tips[-1:])
    length = np.linalg.norm(way, axis=1)
    moving = length > _AT_REST * np.diff(reference.time_ns, append=reference.time_ns[-1] + 1) / NANOSECONDS
    last = np.maximum.accumulate(np.where(moving, np.arange(count), -1))
    ended = reference.time_ns[np.minimum(last + 1, count - 1)]
    counted = (last >= 0) & (reference.time_ns - ended <= SETTLING * NANOSECONDS)
    return np.asarray(way[last] / np.where(length[last] > 0.0, length[last], 1.0)[:, None]), counted


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> tuple[Array, Array]:
    """Return the way of the tip, (m, 3) m, NaN in gaps, and the largest path error of each piece, (m - 1,) m or NaN.

    The pieces are of equal time, `pieces` at most.
    """
    count = max(1, min(pieces, len(arm.time_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return points, np.full(count, np.nan)
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return points, np.asarray(np.fmax(values[0::2, 0], values[1::2, 0]))
