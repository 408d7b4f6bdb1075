"""Block means of the plateaus of records, each block judged by its own velocity, and what of each bag was used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.records.record import BagSource, JointRecord
from rx90_emulator.identification.sliding.plateaus import LEAST_BINS, SCALES, Bins, accelerates, plateau_ranges

USED = "used"
RESTS = "at rest"
CHANGES = "changes of velocity"
ACCELERATES = "steady acceleration or a crest"
SETTLES = "settling"
SHORT = "too short"
LITTLE_TRAVEL = "travel of less than 10 mrad"
UNSTEADY = "blocks of another velocity"
REASONS = (CHANGES, RESTS, LITTLE_TRAVEL, SETTLES, SHORT, ACCELERATES, UNSTEADY, USED)
"""What a sample was used for, or why not."""
RESTS_TRAVEL = 1e-3
"""Travel below which nothing moves, rad."""
_MIN_LISTED_S = 0.05  # s: shorter times are not listed
_MIN_UNUSED_S = 0.5  # s from which a stretch that was not used tells of a speed that is lacking


@dataclass(frozen=True, eq=False)
class BagUse:
    """What was used of one bag of sweeps.

    Attributes:
        bag: the bag.
        stretches: of constant velocity that were used.
        seconds: in these.
        speeds: rad/s, of each element the slowest and the fastest that was used, 0 without any, shape (n_el, 2).
        left_out: seconds by the reason for which they were not used.
        unused: mean speeds of the elements, rad/s, in stretches that were not used, shape (u, n_el); 0 at rest.
    """

    bag: BagSource
    stretches: int
    seconds: float
    speeds: Array
    left_out: Mapping[str, float]
    unused: Array

    @classmethod
    def of(cls, record: JointRecord, elements: Array, state: NDArray[np.intp], velocities: Sequence[Array]) -> BagUse:
        """Return the account of a record.

        Args:
            record: whose account it is.
            elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
            state: of each sample, its place in REASONS, shape (m,).
            velocities: of each stretch's blocks, the elements' where they slide, 0 elsewhere, rad/s, shape (b, n_el).
        """
        period = float(np.median(np.diff(record.time))) if len(record.time) > 1 else 0.0
        speeds = np.zeros((len(elements), 2))
        for e in range(len(elements)):
            mine = [abs(float(v[:, e].mean())) for v in velocities if v[:, e].any()]
            if mine:
                speeds[e] = min(mine), max(mine)
        seconds = {why: float(np.sum(state == k)) * period for k, why in enumerate(REASONS)}
        used = seconds.pop(USED)
        lacking = ~np.isin(state, [REASONS.index(why) for why in (USED, RESTS, SETTLES)])
        edges = np.flatnonzero(np.diff(lacking, prepend=False, append=False)).reshape(-1, 2)
        unused = np.zeros((0, len(elements)))
        for begin, end in edges.tolist():
            lasted = float(record.time[end - 1] - record.time[begin])
            travel = np.abs(elements @ (record.position[end - 1] - record.position[begin]))
            if lasted >= _MIN_UNUSED_S and travel.max() > RESTS_TRAVEL:
                unused = np.vstack([unused, np.where(travel > RESTS_TRAVEL, travel / lasted, 0.0)])
        return cls(record.bag, len(velocities), used, speeds, seconds, unused)

    def text(self, names: Sequence[str]) -> str:
        """Return it as a line.

        Args:
            names: of the elements.
        """
        ranges = [
            f"{name} {low:.3g}" + (f" to {high:.3g}" if f"{low:.3g}" != f"{high:.3g}" else "")
            for name, (low, high) in zip(names, self.speeds.tolist(), strict=True)
            if high
        ]
        used = (
            f"{self.seconds:.3g} s in {self.stretches} stretches, {', '.join(ranges)} rad/s"
            if self.stretches
            else "NOTHING"
        )
        rest = ", ".join(f"{seconds:.3g} s {reason}" for reason, seconds in self.reasons)
        return f"used {used}" + (f"; left out {rest}" if rest else "")

    @property
    def reasons(self) -> list[tuple[str, float]]:
        """Return why how many seconds were not used, the most first."""
        return sorted(((why, s) for why, s in self.left_out.items() if s >= _MIN_LISTED_S), key=lambda pair: -pair[1])


def unused_speeds(usage: Sequence[BagUse], element: int, slowest: float) -> Array:
    """Return the speeds of an element below the slowest one that was used, rad/s, sorted, shape (k,)."""
    speeds = np.sort(np.concatenate([np.zeros(0), *(use.unused[:, element] for use in usage)]))
    return np.asarray(speeds[(speeds > 0.0) & (speeds < slowest)])


_SETTLE_TIME = 0.25  # s, for the servo loops after a change of velocity; their integrators' pole is near 20 /s
_SETTLE_SHARE = 0.5  # of a plateau, within which the bristles must settle for the element to count as sliding
_MAX_BLOCK_S = 0.25  # s
_MAX_BLOCK_TRAVEL = 0.02  # rad in a block: the rigid torque is linear in it but for a negligible rest
_MIN_BLOCK_SAMPLES = 8  # samples
_MIN_HALF_S = 1.0  # s
_CONTEXT_WINDOW_S = (0.2, 1.0)  # s before and behind a short stretch, at least and at most, that tell whether it is one
_VELOCITY_TOLERANCE = 0.15  # of the velocity that it may change by there
_OUTLIER_SD = 5.0  # standard deviations from a block's median
_BLOCK_VELOCITY_TOLERANCE = 0.75  # of the plateau's velocity that a block's may be off by

SETTLE_DISTANCE = 5e-3
"""Travel after which a bristle has its steady deflection, rad: ten times g or more for joints of this class."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Block means of plateaus: b blocks of n joints with n_el friction elements.

    Attributes:
        position: rad, shape (b, n).
        velocity: of the straight line fitted to the plateau's velocity, rad/s, shape (b, n).
        acceleration: slope of that line, rad/s^2, shape (b, n).
        torque: drive torque, Nm, shape (b, n).
        count: samples in each mean, shape (b,).
        sliding: whether an element slides steadily, shape (b, n_el).
        plateau: number of the plateau, shape (b,).
        source: number of the record, shape (b,).
        time: in the series, s, shape (b,).
        noise: covariance of the torque's samples, Nm^2, shape (n, n).
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    count: Array
    sliding: NDArray[np.bool_]
    plateau: NDArray[np.int64]
    source: NDArray[np.int64]
    time: Array
    noise: Array

    def __len__(self) -> int:
        return len(self.count)


def find_blocks(records: Sequence[JointRecord], elements: Array) -> tuple[Blocks, tuple[BagUse, ...]]:
    """Cut records into plateaus, and these into blocks; say what was used of each record.

    Args:
        records: of the same joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).

    Raises:
        IdentificationError: if no record holds a plateau in which an element slides.
    """
    parts: list[Blocks] = []
    uses = []
    for source, (record, begin) in enumerate(zip(records, _beginnings(records), strict=True)):
        cut = _Cut(record, elements, source, begin)
        parts += cut.blocks(len(parts))
        uses.append(cut.use())
    if not parts:
        each = "; ".join(
            f"{record.source}: {', '.join(f'{s:.3g} s {why}' for why, s in use.reasons)}"
            for record, use in zip(records, uses, strict=True)
        )
        raise IdentificationError(
            f"{each or 'no bag'}: no stretch of constant velocity; accepted: sweeps at constant velocity"
        )
    joined = {field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Blocks)}
    weights = np.array([part.count.sum() for part in parts])
    joined["noise"] = np.einsum("p,pij->ij", weights / weights.sum(), np.array([part.noise for part in parts]))
    return Blocks(**joined), tuple(uses)


def _beginnings(records: Sequence[JointRecord]) -> list[float]:
    """Return when each record begins in the series, s: by its stamps, or one behind the other where these overlap."""
    order = sorted(records, key=lambda record: float(record.time[0]))
    if all(a.time[-1] <= b.time[0] for a, b in pairwise(order)):
        return [float(record.time[0]) for record in records]
    lasting = [float(record.time[-1] - record.time[0]) for record in records]
    return [sum(lasting[:k]) for k in range(len(records))]


class _Cut:
    """Cuts one record into blocks, and keeps account of what each sample was used for."""

    def __init__(self, record: JointRecord, elements: Array, source: int, begin: float) -> None:
        self._record, self._elements, self._source, self._begin = record, elements, source, begin
        self._state = np.full(len(record.time), REASONS.index(CHANGES))
        self._parts: list[Blocks] = []

    def blocks(self, first: int) -> list[Blocks]:
        """Return the blocks of each plateau; plateaus are numbered from `first` on."""
        if len(self._record.time) < 2:
            return []
        period = float(np.median(np.diff(self._record.time)))
        top = np.percentile(np.abs(self._record.velocity), 99.0, axis=0)
        for seconds, fastest in SCALES:
            free = self._state != REASONS.index(USED)
            edges = np.flatnonzero(np.diff(free, prepend=False, append=False))
            for begin, end in edges.reshape(-1, 2).tolist():
                bins = Bins.of(self._record, slice(begin, end), period, seconds)
                for start, stop in [] if bins is None else plateau_ranges(bins, top):
                    assert bins is not None
                    rows = slice(begin + start * bins.size, begin + stop * bins.size)
                    self._take(rows, bins.size, fastest, first)
        return self._parts

    def use(self) -> BagUse:
        """Return the account."""
        velocities = [part.velocity @ self._elements.T * part.sliding for part in self._parts]
        return BagUse.of(self._record, self._elements, self._state, velocities)

    def _take(self, rows: slice, size: int, fastest: float, first: int) -> None:
        """Add the blocks of one plateau, or say why there are none."""
        record = self._record
        duration = float(record.time[rows.stop - 1] - record.time[rows.start])
        # Travel over time is more precise than the mean of the drive's velocities.
        travel = np.abs(self._elements @ (record.position[rows.stop - 1] - record.position[rows.start]))
        if travel.max() > fastest * duration:
            return
        sliding = travel * _SETTLE_SHARE >= SETTLE_DISTANCE
        if not sliding.any():
            self._mark(rows, LITTLE_TRAVEL if travel.max() > RESTS_TRAVEL else RESTS)
            return
        self._mark(rows, SETTLES)
        start = self._settled(rows, sliding)
        kept = slice(start, rows.stop)
        if (rows.stop - start) // size < LEAST_BINS:
            self._mark(kept, SHORT)
            return
        halves = (start + rows.stop) // 2, rows.stop - 1
        # The first half may be a slow start; of a wave's crest a short half would look straight.
        long = float(record.time[halves[1]] - record.time[halves[0]]) >= _MIN_HALF_S
        for begin in (start, halves[0])[: 1 + long]:
            kept = slice(begin, rows.stop)
            if not self._accelerates(kept, size, sliding, long=long):
                break
        else:
            self._mark(kept, ACCELERATES)
            return
        self._add(kept, sliding, first + len(self._parts))

    def _accelerates(self, kept: slice, size: int, sliding: NDArray[np.bool_], *, long: bool) -> bool:
        moving = self._moving(sliding)
        if accelerates(self._binned(kept, size), moving):
            return True
        around = kept if long else _around(self._record, self._elements[sliding], kept, size)
        return around != kept and accelerates(self._binned(around, size), moving)

    def _binned(self, rows: slice, size: int) -> Array:
        count = (rows.stop - rows.start) // size
        velocity = self._record.velocity[rows.start : rows.start + count * size]
        return np.asarray(velocity.reshape(count, size, velocity.shape[1]).mean(axis=1))

    def _mark(self, rows: slice | NDArray[np.int64], reason: str) -> None:
        self._state[rows] = REASONS.index(reason)

    def _moving(self, sliding: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which joints take part in the motion of an element that slides."""
        return np.asarray((self._elements[sliding] != 0.0).any(axis=0))

    def _settled(self, rows: slice, sliding: NDArray[np.bool_]) -> int:
        """Return the sample from which on servo loops and bristles of the sliding elements are settled."""
        record = self._record
        inputs = record.position[rows] @ self._elements[sliding].T
        along = inputs * np.sign(inputs[-1] - inputs[0])
        gone = (along - np.minimum.accumulate(along, axis=0)).min(axis=1)
        late = record.time[rows] - record.time[rows][0] >= _SETTLE_TIME
        ready = np.flatnonzero(late & (gone >= SETTLE_DISTANCE))
        return int(rows.start + ready[0]) if len(ready) else rows.stop

    def _add(self, kept: slice, sliding: NDArray[np.bool_], plateau: int) -> None:
        """Add the blocks of a settled plateau."""
        record = self._record
        count = kept.stop - kept.start
        if count < _MIN_BLOCK_SAMPLES:
            self._mark(kept, SHORT)
            return
        duration = float(record.time[kept.stop - 1] - record.time[kept.start])
        speed = np.abs(self._elements @ (record.position[kept.stop - 1] - record.position[kept.start])) / duration
        length = min(_MAX_BLOCK_S, _MAX_BLOCK_TRAVEL / max(float(speed.max()), 1e-9))
        size = min(max(_MIN_BLOCK_SAMPLES, int(length * (count - 1) / duration)), count)
        rows = kept.start + np.arange(count // size * size).reshape(-1, size)
        self._mark(kept, SHORT)
        self._mark(rows, UNSTEADY)
        rows = rows[self._steady(rows, sliding)]
        if len(rows) == 0:
            return
        self._mark(rows, USED)
        mean_time = record.time[rows].mean(axis=1)
        flat = rows.ravel()
        velocity, acceleration = _line(record.time[flat], record.velocity[flat], mean_time[:, None])
        torque = record.torque[rows]
        mean, used = _robust_mean(torque)
        steps = np.diff(torque, axis=1).reshape(-1, torque.shape[2])
        part = Blocks(
            position=record.position[rows].mean(axis=1),
            velocity=velocity,
            acceleration=acceleration,
            torque=mean,
            count=used,
            sliding=np.tile(sliding, (len(rows), 1)),
            plateau=np.full(len(rows), plateau),
            source=np.full(len(rows), self._source),
            time=mean_time - record.time[0] + self._begin,
            noise=_clipped_covariance(steps) / 2.0,
        )
        self._parts.append(part)

    def _steady(self, rows: NDArray[np.int64], sliding: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which blocks, their samples' numbers in `rows` (b, m), have a velocity of their own near that of all.

        Either the mean velocity or the travel over time may say so: the one is noisy, the other counts encoder steps.
        """
        record, elements = self._record, self._elements[sliding].T
        time = record.time[rows[:, -1]] - record.time[rows[:, 0]]
        travel = (record.position[rows[:, -1]] - record.position[rows[:, 0]]) @ elements / time[:, None]
        steady = np.zeros(len(rows), dtype=np.bool_)
        usual = (record.position[rows[-1, -1]] - record.position[rows[0, 0]]) @ elements
        usual = usual / (record.time[rows[-1, -1]] - record.time[rows[0, 0]])
        for own in (travel, record.velocity[rows].mean(axis=1) @ elements):
            steady |= (np.abs(own - usual) <= _BLOCK_VELOCITY_TOLERANCE * np.abs(usual)).all(axis=1)
        return steady


def _around(record: JointRecord, elements: Array, kept: slice, size: int) -> slice:
    """Return a short stretch with what goes on at nearly its velocity before and behind, if both do.

    Noise cuts a wave into stretches too short to show its curvature; a stretch between two changes of velocity stays
    as it is.
    """
    usual = (record.velocity[kept] @ elements.T).mean(axis=0)
    period = float(record.time[kept.stop - 1] - record.time[kept.start]) / (kept.stop - 1 - kept.start)
    least, most = (round(seconds / period / size) for seconds in _CONTEXT_WINDOW_S)
    bins = [0, 0]
    for side, (begin, step) in enumerate(((kept.start - size, -size), (kept.stop, size))):
        for k in range(most):
            at = begin + k * step
            part = record.velocity[max(at, 0) : at + size] @ elements.T
            if (
                at < 0
                or len(part) < size
                or (np.abs(part.mean(axis=0) - usual) > _VELOCITY_TOLERANCE * np.abs(usual)).any()
            ):
                break
            bins[side] += 1
    if min(bins) < max(1, least):
        return kept
    return slice(kept.start - bins[0] * size, kept.stop + bins[1] * size)


def _line(time: Array, values: Array, at: Array) -> tuple[Array, Array]:
    """Return the straight line through values (m, n) at the times `at` (b, 1), and its slope, both (b, n)."""
    centre = time.mean()
    spread = time - centre
    slope = spread @ values / (spread @ spread)
    return values.mean(axis=0) + (at - centre) * slope, np.tile(slope, (len(at), 1))


def _robust_mean(samples: Array) -> tuple[Array, Array]:
    """Return the means over axis 1 without outliers, shape (b, n), and how many samples are in the smallest."""
    middle = np.median(samples, axis=1, keepdims=True)
    distance = np.abs(samples - middle)
    spread = 1.4826 * np.median(distance, axis=1, keepdims=True)
    good = distance <= _OUTLIER_SD * spread + 1e-12
    used = good.sum(axis=1)
    return np.where(good, samples, 0.0).sum(axis=1) / used, used.min(axis=1).astype(np.float64)


def _clipped_covariance(steps: Array) -> Array:
    """Return the second moment of the rows, shape (n, n), without rows that hold an outlier."""
    spread = 1.4826 * np.median(np.abs(steps), axis=0)
    good = (np.abs(steps) <= _OUTLIER_SD * spread + 1e-12).all(axis=1)
    rows = steps[good] if good.any() else steps
    return np.asarray(rows.T @ rows / len(rows))
