"""Find plateaus, stretches of a record in which every joint keeps its velocity, and take block means of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.records.record import JointRecord

_BIN = 0.02  # s, over which velocities are compared
_RELATIVE = 0.02  # change of velocity that ends a plateau
_NOISE = 6.0  # or this many standard deviations of a bin's velocity
_AT_REST = 0.01  # or this part of the fastest joint's velocity: moving joints shake those at rest
_END = 3  # bins at the end of a plateau in which the next change of velocity may have begun
_SETTLE_TIME = 0.25  # s, for the servo loops after a change of velocity; their integrators' pole is near 20 /s
_SETTLE_SHARE = 0.5  # of a plateau, within which the bristles must settle for the element to count as sliding
_LONGEST_BLOCK = 0.25  # s
_LONGEST_TRAVEL = 0.02  # rad in a block: the rigid torque is linear in it but for a negligible rest
_SHORTEST_BLOCK = 8  # samples
_OUTLIER = 5.0  # standard deviations from a block's median

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
    noise: Array

    def __len__(self) -> int:
        return len(self.count)


def find_blocks(records: Sequence[JointRecord], elements: Array) -> Blocks:
    """Cut records into plateaus, and these into blocks.

    Args:
        records: of the same joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).

    Raises:
        IdentificationError: if no record holds a plateau in which an element slides.
    """
    parts, plateaus = [], 0
    for source, record in enumerate(records):
        for start, stop in plateau_ranges(record):
            part = _plateau_blocks(record, elements, slice(start, stop), plateaus, source)
            if part is not None:
                parts.append(part)
                plateaus += 1
    if not parts:
        names = ", ".join(str(record.source) for record in records) or "no bag"
        raise IdentificationError(f"{names}: no stretch of constant velocity; accepted: sweeps at constant velocity")
    joined = {field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Blocks)}
    weights = np.array([part.count.sum() for part in parts])
    joined["noise"] = np.einsum("p,pij->ij", weights / weights.sum(), np.array([part.noise for part in parts]))
    return Blocks(**joined)


def plateau_ranges(record: JointRecord) -> list[tuple[int, int]]:
    """Return the range of samples, the end excluded, of each stretch in which every joint keeps its velocity."""
    if len(record.time) < 2:
        return []
    period = float(np.median(np.diff(record.time)))
    size = max(1, round(_BIN / period))
    bins = len(record.time) // size
    velocity = record.velocity[: bins * size].reshape(bins, size, -1).mean(axis=1)
    if bins < 4:
        return []
    jumps = np.abs(np.diff(velocity, axis=0))
    tolerance = _NOISE * 1.4826 / np.sqrt(2.0) * np.median(jumps, axis=0) + 1e-9
    first = np.arange(bins) * size
    last = np.minimum(first + size, len(record.time) - 1)
    gap = record.time[last] - record.time[first] > 2.0 * size * period
    number = np.empty(bins, dtype=np.int64)
    _number_plateaus(velocity, tolerance, gap, _RELATIVE, _AT_REST, number)
    edges = np.flatnonzero(np.diff(number, prepend=-1, append=number[-1] + 1))
    # The first bin and the last ones may hold a part of a change of velocity.
    cut = [(int(start + 1), int(stop - _END)) for start, stop in pairwise(edges)]
    return [(start * size, stop * size) for start, stop in cut if stop - start > 1]


@kernel
def _number_plateaus(
    velocity: Array,
    tolerance: Array,
    gap: NDArray[np.bool_],
    relative: float,
    at_rest: float,
    number: NDArray[np.int64],
) -> None:
    """Number the runs of bins whose velocities stay near the run's mean, shape (bins, n) to (bins,)."""
    bins, joints = velocity.shape
    mean = velocity[0].copy()
    held, current = 1, 0
    number[0] = 0
    for k in range(1, bins):
        same = not gap[k] and not gap[k - 1]
        fastest = np.abs(mean).max()
        for j in range(joints):
            if abs(velocity[k, j] - mean[j]) > max(tolerance[j], relative * abs(mean[j]), at_rest * fastest):
                same = False
        if same:
            held += 1
            for j in range(joints):
                mean[j] += (velocity[k, j] - mean[j]) / held
        else:
            current += 1
            held = 1
            for j in range(joints):
                mean[j] = velocity[k, j]
        number[k] = current


def _plateau_blocks(record: JointRecord, elements: Array, rows: slice, plateau: int, source: int) -> Blocks | None:
    """Return the blocks of one plateau, or None if nothing slides steadily for long enough."""
    time = record.time[rows]
    duration = float(time[-1] - time[0])
    position = record.position[rows]
    # Travel over time is more precise than the mean of the drive's velocities.
    speed = np.abs(elements @ ((position[-1] - position[0]) / duration))
    with np.errstate(divide="ignore"):
        settling = SETTLE_DISTANCE / speed
    sliding = settling <= _SETTLE_SHARE * duration
    if not sliding.any():
        return None
    start = int(np.searchsorted(time, time[0] + max(_SETTLE_TIME, settling[sliding].max())))
    length = min(_LONGEST_BLOCK, _LONGEST_TRAVEL / float(speed.max()))
    size = max(_SHORTEST_BLOCK, int(length * (len(time) - 1) / duration))
    size = min(size, len(time) - start)
    count = (len(time) - start) // size if size >= _SHORTEST_BLOCK else 0
    if count == 0:
        return None
    kept = slice(start, start + count * size)
    mean_time = _reshape(time[kept, None], count).mean(axis=1)
    velocity, acceleration = _line(time[kept], record.velocity[rows][kept], mean_time)
    torque = _reshape(record.torque[rows][kept], count)
    mean, used = _robust_mean(torque)
    steps = np.diff(torque, axis=1).reshape(-1, torque.shape[2])
    return Blocks(
        position=_reshape(position[kept], count).mean(axis=1),
        velocity=velocity,
        acceleration=acceleration,
        torque=mean,
        count=used,
        sliding=np.tile(sliding, (count, 1)),
        plateau=np.full(count, plateau),
        source=np.full(count, source),
        noise=_clipped_covariance(steps) / 2.0,
    )


def _reshape(values: Array, count: int) -> Array:
    return values.reshape(count, -1, values.shape[1])


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
    good = distance <= _OUTLIER * spread + 1e-12
    used = good.sum(axis=1)
    return np.where(good, samples, 0.0).sum(axis=1) / used, used.min(axis=1).astype(np.float64)


def _clipped_covariance(steps: Array) -> Array:
    """Return the second moment of the rows, shape (n, n), without rows that hold an outlier."""
    spread = 1.4826 * np.median(np.abs(steps), axis=0)
    good = (np.abs(steps) <= _OUTLIER * spread + 1e-12).all(axis=1)
    rows = steps[good] if good.any() else steps
    return np.asarray(rows.T @ rows / len(rows))
