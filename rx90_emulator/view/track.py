"""Recorded series at any time, the difference of two, and the path error of one against its set-points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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

TIP, PATH_ERROR = "tip", "path error"
_AT_REST = 1e-4  # m/s, of the set-points: below it they have no direction of their own
_GAP = 3.5  # times the median interval: fewer than three messages that are missing are interpolated
_BLOCK = 1 << 14  # samples; for all of them at once some steps would take too much memory


def since(time_ns: int, origin_ns: int) -> float:
    """Return how long after the origin a stamp is, s: the time that the page shows."""
    return (time_ns - origin_ns) / NANOSECONDS


def seconds(time_ns: int) -> str:
    """Return a time in s, to the ms."""
    return f"{since(time_ns, 0):.3f}"


@dataclass(frozen=True, eq=False)
class Track(JointSeries):
    """A series whose stamps increase, and what is known of the times between them.

    Attributes:
        gap_ns: an interval longer than this is a gap, in which nothing is known.
    """

    gap_ns: int = 0

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
        if not (steps[begin:] > 0).all():
            series = series.take(begin + np.unique(stamps[begin:], return_index=True)[1])
        elif begin:
            series = series.take(slice(begin, None))
        return cls(**vars(series), gap_ns=gap_ns), len(back)

    @property
    def begin_ns(self) -> int:
        """Return the first time."""
        return int(self.stamp_ns[0])

    @property
    def end_ns(self) -> int:
        """Return the last time."""
        return int(self.stamp_ns[-1])

    def gaps(self) -> NDArray[np.int64]:
        """Return the last time before and the first one after each gap, shape (m, 2)."""
        rows = np.flatnonzero(np.diff(self.stamp_ns) > self.gap_ns)
        return np.stack([self.stamp_ns[rows], self.stamp_ns[rows + 1]], axis=1)

    def at(self, field: str, time_ns: Int64Array) -> Array:
        """Return a field at any times, shape (m, k): a sample as it is, between two samples the line between them.

        NaN in gaps, before the first sample and after the last one.
        """
        wanted = np.asarray(time_ns, dtype=np.int64)
        values, last = self.fields[field], len(self.stamp_ns) - 1
        before = np.clip(np.searchsorted(self.stamp_ns, wanted, side="right") - 1, 0, last)
        after = np.minimum(before + 1, last)
        later, step = wanted - self.stamp_ns[before], self.stamp_ns[after] - self.stamp_ns[before]
        between = (later > 0) & (later < step) & (step <= self.gap_ns)
        share = np.where(between, later / np.maximum(step, 1), 0.0)[:, None]
        low = values[before]
        with np.errstate(invalid="ignore"):
            found = np.where(share > 0.0, low + share * (values[after] - low), low)
        found[~(between | (later == 0))] = np.nan
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
        rows = np.searchsorted(self.stamp_ns, edges)
        filled = np.flatnonzero(np.diff(rows))
        if len(filled):
            lowest, highest = least_and_largest(self.fields[field][: rows[-1]], rows[filled])
            least[filled], largest[filled] = np.fmin(least[filled], lowest), np.fmax(largest[filled], highest)
        time = np.stack([edges[:-1], edges[1:] - 1], axis=1).reshape(-1)
        ends = [np.where(rising, least, largest), np.where(rising, largest, least)]
        return time, np.stack(ends, axis=1).reshape(2 * count, -1)

    def worst(self) -> list[tuple[float, int]]:
        """Return the largest absolute position of each column, with its sign, and its stamp, ns; NaN does not count."""
        values = self.fields["position"]
        rows = np.nanargmax(np.abs(values), axis=0).tolist()
        return [(float(values[row, column]), int(self.stamp_ns[row])) for column, row in enumerate(rows)]


class Difference(NamedTuple):
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


def difference(first: Track, second: Track, chain: RigidChain, paths: tuple[Path, Path]) -> Difference:
    """Compare the positions of two tracks of one arm; the second's times are already moved to the first's.

    Raises:
        BagError: if they have no time in common outside of gaps.
    """
    begin, end = max(first.begin_ns, second.begin_ns), min(first.end_ns, second.end_ns)
    low, high = np.searchsorted(first.stamp_ns, begin), np.searchsorted(first.stamp_ns, end, side="right")
    stamps, own = first.stamp_ns[low:high], first.fields["position"][low:high]
    joints, tip = np.empty((len(stamps), len(first.names))), np.empty((len(stamps), 1))
    for rows in _blocks(len(stamps)):
        other = second.at("position", stamps[rows])
        joints[rows] = other - own[rows]
        tip[rows, 0] = np.linalg.norm(tip_position(chain, other) - tip_position(chain, own[rows]), axis=1)
    known = np.isfinite(tip[:, 0])
    if not known.any():
        spans = " and ".join(
            f"{plain(path)} from {seconds(track.begin_ns)} to {seconds(track.end_ns)} s"
            for path, track in zip(paths, (first, second), strict=True)
        )
        raise BagError(f"{spans} have no time in common; accepted: --align start, trajectory, or a time in s")
    if not known.all():
        stamps, joints, tip = stamps[known], joints[known], tip[known]
    exact = float(np.isin(stamps, second.stamp_ns, assume_unique=True).mean())
    of_joints = Track(first.topic, first.names, stamps, joints, gap_ns=first.gap_ns)
    return Difference(of_joints, Track(TIP, (TIP,), stamps, tip, gap_ns=first.gap_ns), exact)


def path_error_track(arm: Track, reference: Track | None, chain: RigidChain) -> Track | None:
    """Return the distance of the tip from the path of its set-points under PATH_ERROR, m; None without set-points.

    It is the distance from the set-point of the same time, without its part along the path, which is the lag. It counts
    as `LineTask.counted` says of a line: while the set-points move and until the arm has settled, where their path has
    the direction of their last motion. Elsewhere it is NaN.
    """
    if reference is None:
        return None
    direction, counted = _directions(reference, chain)
    error = np.empty((len(arm.stamp_ns), 1))
    for rows in _blocks(len(arm.stamp_ns)):
        stamps = arm.stamp_ns[rows]
        target = tip_position(chain, reference.at("position", stamps))
        off = tip_position(chain, arm.fields["position"][rows]) - target
        place = np.searchsorted(reference.stamp_ns, stamps, side="right") - 1
        across = off - np.sum(off * direction[place], axis=1)[:, None] * direction[place]
        error[rows, 0] = np.where(counted[place] & (place >= 0), np.linalg.norm(across, axis=1), np.nan)
    return Track(PATH_ERROR, (PATH_ERROR,), arm.stamp_ns, error, gap_ns=arm.gap_ns)


def _directions(reference: Track, chain: RigidChain) -> tuple[Array, NDArray[np.bool_]]:
    """Return the direction of the path at each set-point, shape (n, 3), and whether its path error counts, (n,)."""
    stamps = reference.stamp_ns
    tips = np.empty((len(stamps), 3))
    for rows in _blocks(len(stamps)):
        tips[rows] = tip_position(chain, reference.fields["position"][rows])
    way = np.diff(tips, axis=0, append=tips[-1:])
    length = np.linalg.norm(way, axis=1)
    moving = length > _AT_REST * np.diff(stamps, append=stamps[-1] + 1) / NANOSECONDS
    last = np.maximum.accumulate(np.where(moving, np.arange(len(stamps)), -1))
    counted = (last >= 0) & (stamps - stamps[np.minimum(last + 1, len(stamps) - 1)] <= SETTLING * NANOSECONDS)
    return np.asarray(way[last] / np.where(length[last] > 0.0, length[last], 1.0)[:, None]), counted


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> tuple[Array, Array]:
    """Return the way of the tip, (m, 3) m, NaN in gaps, and the largest path error of each piece, (m - 1,) m or NaN.

    The pieces are of equal time, `pieces` at most.
    """
    count = max(1, min(pieces, len(arm.stamp_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return points, np.full(count, np.nan)
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return points, np.asarray(np.fmax(values[0::2, 0], values[1::2, 0]))


def _blocks(count: int) -> Iterator[slice]:
    return (slice(start, start + _BLOCK) for start in range(0, count, _BLOCK))
