"""Find plateaus: stretches of a record in which every joint keeps its velocity, but for ripple and noise."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import fdtrc

from rx90_common.base.arrays import Array
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.records.record import JointRecord

_BIN_SAMPLES = 3  # or so many samples: a single one at 67 Hz is all noise
_VELOCITY_CHANGE = 0.02  # change of velocity that ends a plateau
_NOISE_SD = 6.0  # or this many standard deviations of a bin's velocity
_REST_SHARE = 0.01  # or this part of the fastest joint's velocity: moving joints shake those at rest
_MAX_VELOCITY_ERROR = 0.75  # of its mean that a velocity may be off by, however noisy it is: it keeps its sign
_NOISE_CAP_SHARE = 0.01  # or this part of the joint's own fastest velocity
_MIN_NOISE_CAP = 3e-3  # rad/s, or this
_NOISE_WINDOW_S = 1.0  # s over which the noise is taken
_NOISE_WINDOW_BINS = 10  # or so many bins
_END_S = 0.06  # s at the end of a plateau in which the next change of velocity may have begun
_MAX_TREND = 0.003  # of the velocity that a plateau may change by
_P_VALUE = 0.01  # probability below which such a change is no accident

SCALES = ((0.02, np.inf), (0.1, 0.1), (0.4, 0.025))
"""Times over which velocities are compared, s, with the speed up to which, rad/s: a drive that creeps ripples slowly,
and what a joint does within 10 mrad does not count."""
LEAST_BINS = 5
"""Bins in which an acceleration can be told from noise."""


@dataclass(frozen=True, eq=False)
class Bins:
    """Means of a record's velocity over short times.

    Attributes:
        size: samples in each.
        end: bins at the end of a plateau in which the next change of velocity may have begun.
        velocity: rad/s, shape (b, n).
        tolerance: by which it may be off because of noise, rad/s, shape (b, n).
        gap: whether samples are missing within or behind a bin, shape (b,).
    """

    size: int
    end: int
    velocity: Array
    tolerance: Array
    gap: NDArray[np.bool_]

    @classmethod
    def of(cls, record: JointRecord, rows: slice, period: float, seconds: float) -> Bins | None:
        """Return the bins of a part of a record; None for one that is too short for any plateau.

        Args:
            record: whose samples these are.
            rows: of the record.
            period: between two samples, s.
            seconds: in a bin; it holds three samples at least.
        """
        time = record.time[rows]
        if len(time) < 2:
            return None
        size = max(_BIN_SAMPLES, round(seconds / period))
        count = len(time) // size
        if count < 4:
            return None
        velocity = record.velocity[rows][: count * size].reshape(count, size, -1).mean(axis=1)
        first = np.arange(count) * size
        last = np.minimum(first + size, len(time) - 1)
        gap = time[last] - time[first] > 2.0 * size * period
        span = max(_NOISE_WINDOW_BINS, round(_NOISE_WINDOW_S / (size * period)))
        end = max(1, round(_END_S / (size * period)))
        return cls(size, end, velocity, _NOISE_SD * _noise(velocity, span) + 1e-9, gap)


def _noise(velocity: Array, span: int) -> Array:
    """Return the standard deviation of each bin's velocity, shape (b, n).

    It is taken from third differences, in which an acceleration, and its change, do not count; their variance is 20
    times that of a velocity. The median over the bins around leaves out jumps, and tells rest from motion.
    """
    third = np.abs(np.diff(velocity, n=3, axis=0, prepend=velocity[:1], append=velocity[-2:]))
    middle = [median_filter(column, 2 * (span // 2) + 1, mode="nearest") for column in third.T]
    return np.asarray(1.4826 / np.sqrt(20.0) * np.stack(middle, axis=1))


def plateau_ranges(bins: Bins, fastest: Array) -> list[tuple[int, int]]:
    """Return the range of bins, the end excluded, of each stretch in which every joint keeps its velocity.

    Args:
        bins: of a part of a record.
        fastest: velocity of each joint in the whole record, rad/s, shape (n,).
    """
    number = np.empty(len(bins.velocity), dtype=np.int64)
    floor = np.maximum(_NOISE_CAP_SHARE * fastest, _MIN_NOISE_CAP)
    # Slow ripple hardly shows in third differences; jumps show it, and accelerations, too, hence the limit.
    jumps = _NOISE_SD * 1.4826 / np.sqrt(2.0) * np.median(np.abs(np.diff(bins.velocity, axis=0)), axis=0)
    tolerance = np.maximum(bins.tolerance, np.minimum(jumps, floor))
    _number_plateaus(
        bins.velocity, tolerance, bins.gap, floor, (_VELOCITY_CHANGE, _REST_SHARE, _MAX_VELOCITY_ERROR), number
    )
    edges = np.flatnonzero(np.diff(number, prepend=-1, append=number[-1] + 1))
    # The first bin and the last ones may hold a part of a change of velocity.
    cut = [(int(start + 1), int(stop - bins.end)) for start, stop in pairwise(edges)]
    return [(start, stop) for start, stop in cut if stop - start > 1]


@kernel
def _number_plateaus(
    velocity: Array,
    tolerance: Array,
    gap: NDArray[np.bool_],
    floor: Array,
    shares: tuple[float, float, float],
    number: NDArray[np.int64],
) -> None:
    """Number the runs of bins whose velocities stay near the run's mean, shape (bins, n) to (bins,)."""
    bins, joints = velocity.shape
    relative, at_rest, steady = shares
    mean = velocity[0].copy()
    held, current = 1, 0
    number[0] = 0
    for k in range(1, bins):
        same = not gap[k] and not gap[k - 1]
        fastest = np.abs(mean).max()
        for j in range(joints):
            noise = min(tolerance[k, j], max(steady * abs(mean[j]), floor[j]))
            if abs(velocity[k, j] - mean[j]) > max(noise, relative * abs(mean[j]), at_rest * fastest):
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


def accelerates(velocity: Array, moving: NDArray[np.bool_]) -> bool:
    """Return whether a moving joint speeds up, slows down or turns at the crest of a wave, rather than ripples.

    A parabola through the velocities changes by more than 0.3 %, and explains more than chance does (F test, with
    the first autocorrelation of what is left taken into account).

    Args:
        velocity: of the bins of a plateau, rad/s, shape (b, n), `LEAST_BINS` or more.
        moving: which joints move, shape (n,).
    """
    count = len(velocity)
    at = np.linspace(-1.0, 1.0, count)
    basis = np.linalg.qr(np.vander(at, 3))[0]
    fitted = basis @ (basis.T @ velocity)
    left = velocity - fitted
    mean = velocity.mean(axis=0)
    power = np.maximum(np.sum(left**2, axis=0), 1e-24)
    repeated = np.clip(np.sum(left[1:] * left[:-1], axis=0) / power, 0.0, 0.95)
    free = np.maximum((count - 3) * (1.0 - repeated) / (1.0 + repeated), 1.0)
    explained = np.sum((fitted - mean) ** 2, axis=0) / 2.0
    chance = fdtrc(2.0, free, explained / power * free)
    change = np.ptp(fitted, axis=0)
    return bool(np.any(moving & (change > _MAX_TREND * np.abs(mean)) & (chance < _P_VALUE)))
