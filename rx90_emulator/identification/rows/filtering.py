"""Runs at an even rate, differentiated without delay, and the low-pass that torque and model share.

Positions pass a Butterworth filter forwards and backwards, which causes no delay; velocity and acceleration are the
derivatives of the quintic spline through the filtered samples (central differences lose a quarter of the velocity at a
fifth of the sampling rate, the spline less than a hundredth). The torque does not pass this filter: it passes one
low-pass together with all columns of the model (Gautier 1997, "Dynamic identification of robots with power model":
parallel filtering), so that the filter distorts both sides of the equation in the same way.

A fit takes the widest band in which the positions' noise leaves the accelerations clean: rise and bristle of a friction
show within milliseconds of a reversal, however slow the motion is, and what a narrower band blurs biases all else.
Errors are stated in a band that follows from the motion alone (Gautier's rule), so that runs of the same motion, and
models of one run, are compared in the same band. Gaps that are short beside the bandwidth hide no motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, firwin, kaiserord, sosfiltfilt, upfirdn, welch

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted
from rx90_emulator.identification.records import BagSource, JointRecord

FILTER_ORDER = 4
"""Of the Butterworth filter, in each direction."""
STOPBAND_DB = 60.0
"""Of the parallel filter beyond twice its bandwidth."""
POSITION_OVER_MOTION = 20.0
"""Least bandwidth of the positions over the motion's: the torque's is 6.7 times it, where Gautier's rule is 5 to 10."""
ACCELERATION_NOISE = 0.1
"""Of a joint's RMS acceleration, that the positions' noise may have in their band. It grows with the band to the power
2.5, and a fiftieth of it passes the torque's low-pass: an inertia appears too small by the square of that."""
MOST_ROWS = 30_000
"""Of all joints and runs, for which the torque's band ends earlier: more say little more, and take their time."""
POSITION_OVER_TORQUE = 3.0
"""Where the torque's low-pass ends, the positions' filter has hardly begun: gain 0.96."""
SIGNAL_OVER_FLOOR = 10.0
"""Power of a motion over that of the noise of its positions where the motion's band ends at the latest."""
MOTION_POWER = 0.95
"""Share of the velocity's power within the motion's band."""
MOST_OF_RATE = 0.3
"""Largest bandwidth of the positions over the sampling rate."""
MOVING = 0.05
"""Speed of a joint that moves over that of the fastest joint: slower ones tremble with the arm."""
LEAST_SPEED = 1e-3
"""rad/s: a joint that is never faster rests."""
USUAL_SPEED = 0.9
"""Quantile of the speeds that stands for a run's speed."""
ROWS_PER_HZ = 2.5
"""Rows per second over the bandwidth of the torque: neighbours' noise is nearly independent."""
LEAST_SAMPLES = 64
"""Without a gap, of a run."""
SPECTRUM_TIME = 4.0
"""s, of the pieces that spectra are averaged over."""
GAP_PERIODS = 3.5
"""Periods without a sample that are a gap."""
BRIDGED_PERIODS = 0.25
"""Longest gap, in periods of the positions' bandwidth, that does not split a run."""
_SPLINE_END = 10  # samples in which the error at a quintic spline's end fades
_BLOCK_SAMPLES = 8192  # samples whose columns are in memory at a time
_STAMP_TOLERANCE = 1e-3  # largest distance of a stamp from an even grid, in periods


class Bandwidths(NamedTuple):
    """Bandwidths of the two filters.

    Attributes:
        position: of the positions' Butterworth filter (both directions together: half the amplitude), Hz.
        torque: of the low-pass that torque and model share (half the amplitude at 1.5 times it), Hz.
    """

    position: float
    torque: float

    @classmethod
    def of(cls, records: Sequence[JointRecord], given: float | None = None) -> Bandwidths:
        """Return the bandwidths for a fit: the widest with clean accelerations, and twenty times the motion's or more.

        Args:
            records: of one robot.
            given: bandwidth of the positions, Hz, in place of that.
        """
        if given is not None:
            if not 0.0 < given < math.inf:
                raise IdentificationError(
                    f"--bandwidth is {given:g} Hz; accepted: a number above 0"
                )
            return cls(given, given / POSITION_OVER_TORQUE)
        bands = np.median([record_bands(record) for record in records], axis=0)
        duration = sum(float(record.time[-1] - record.time[0]) for record in records)
        rows = (
            POSITION_OVER_TORQUE
            * MOST_ROWS
            / (ROWS_PER_HZ * duration * int(moving_joints(records).sum()))
        )
        least = cls.of_motion(records)
        position = min(float(bands[1]), rows, _highest(records))
        if position <= least.position:
            return least
        return cls(position, position / POSITION_OVER_TORQUE)

    @classmethod
    def of_motion(cls, records: Sequence[JointRecord]) -> Bandwidths:
        """Return the bandwidths in which errors are stated: twenty times the motion's band."""
        motion = float(np.median([record_bands(record)[0] for record in records]))
        position = min(POSITION_OVER_MOTION * motion, _highest(records))
        return cls(position, position / POSITION_OVER_TORQUE)

    def at_most(self, highest: float) -> Bandwidths:
        """Return these with a positions' bandwidth of at most `highest`, Hz."""
        if self.position <= highest:
            return self
        return Bandwidths(highest, min(self.torque, highest / POSITION_OVER_TORQUE))


def moving_joints(records: Sequence[JointRecord]) -> Mask:
    """Return which joints move in any of the records, shape (n,)."""
    moving = moving_in_any([record.velocity for record in records])
    if not moving.any():
        raise IdentificationError(
            f"{records[0].source}: no joint moves: {', '.join(records[0].names)}; accepted: runs in which joints move"
        )
    return moving


def moving_in_any(velocities: Sequence[Array], among: Mask | slice = slice(None)) -> Mask:
    """Return which joints move in any run, shape (n,); one that trembles with the others, or those `among` them, rests.

    Args:
        velocities: of each run, rad/s, shape (m, n).
        among: joints with whose speeds the others' are compared.
    """
    usual = np.max(
        [np.quantile(np.abs(velocity), USUAL_SPEED, axis=0) for velocity in velocities], axis=0
    )
    return np.asarray((usual > MOVING * usual[among].max(initial=0.0)) & (usual > LEAST_SPEED))


def _highest(records: Sequence[JointRecord]) -> float:
    return MOST_OF_RATE * min(_rate(record.time) for record in records)


def record_bands(record: JointRecord) -> tuple[float, float]:
    """Return two frequencies, Hz: up to it a run has 95 % of its velocities' power; up to it accelerations are clean.

    The latter is that of the joint in the middle.
    """
    start, stop = max(_pieces(record.time), key=lambda piece: piece[1] - piece[0])
    if stop - start < LEAST_SAMPLES:
        samples = counted(stop - start, "sample")
        raise IdentificationError(
            f"{record.source}: {samples} without a gap; accepted: {LEAST_SAMPLES} or more"
        )
    time = record.time[start:stop]
    rate = _rate(time)
    even = _even(time, rate)
    position = _resampled(time, record.position[start:stop], even, 3)[:, moving_joints([record])]
    segment = min(len(even), max(LEAST_SAMPLES, round(SPECTRUM_TIME * rate)))
    frequency, power = welch(position, rate, nperseg=segment, axis=0)
    # The noise of the positions is white: its power is that of the highest frequencies, where no arm moves.
    floor = np.median(power[frequency > 0.25 * rate], axis=0)
    quiet = maximum_filter1d(power, 5, axis=0) < SIGNAL_OVER_FLOOR * floor
    quiet &= frequency[:, None] > frequency[np.argmax(power, axis=0)]
    noise = np.cumsum(quiet, axis=0) > 0
    power = np.where(noise, 0.0, power)
    tiny = np.finfo(np.float64).tiny
    velocity = np.cumsum(power * frequency[:, None] ** 2, axis=0)
    total = np.sum(velocity / np.maximum(velocity[-1], tiny), axis=1)
    acceleration = np.sum(power * frequency[:, None] ** 4, axis=0) * (frequency[1] - frequency[0])
    clean = (5.0 * ACCELERATION_NOISE**2 * acceleration / np.maximum(floor, tiny)) ** 0.2
    return float(frequency[max(1, np.searchsorted(total, MOTION_POWER * total[-1]))]), float(
        np.median(clean)
    )


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """One run at its full, even rate, without the ends that the filters distort.

    Attributes:
        source: the bag.
        names: n joints.
        time: s, even, shape (m,).
        position: rad, zero-phase filtered, shape (m, n).
        velocity: rad/s, derivative of the filtered position, shape (m, n).
        acceleration: rad/s^2, its second derivative, shape (m, n).
        torque: as recorded, at the joints, Nm, shape (m, n).
        bandwidths: of both filters.
    """

    source: BagSource
    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    bandwidths: Bandwidths

    @cached_property
    def rate(self) -> float:
        """Return samples per second."""
        return _rate(self.time)

    @cached_property
    def down(self) -> int:
        """Return how many samples lie between two rows."""
        # Recordings of one rate differ by rounding, and their rows must not differ.
        return max(1, math.floor(self.rate / (ROWS_PER_HZ * self.bandwidths.torque) + 0.01))

    @cached_property
    def taps(self) -> Array:
        """Return the parallel filter, shape (2 h + 1,): Kaiser window, -60 dB beyond twice the bandwidth."""
        return low_pass_taps(self.rate, self.bandwidths.torque)

    @cached_property
    def rows(self) -> Index:
        """Return the samples of the rows, those with a whole length of the filter around them, shape (k,)."""
        half = len(self.taps) // 2
        return np.arange(half, len(self.time) - half, self.down)

    def parallel(self, values: Array) -> Array:
        """Return values at the full rate, (m, ...), with the torque's low-pass, at the rows, shape (k, ...)."""
        return low_pass(values, self.taps, self.down)

    def blocks(self) -> Iterator[tuple[slice, slice]]:
        """Yield pairs of samples and of the rows that `parallel` makes of them, so that memory stays bounded."""
        count = len(self.rows)
        size = max(1, _BLOCK_SAMPLES // self.down)
        for first in range(0, count, size):
            last = min(first + size, count)
            yield (
                slice(first * self.down, (last - 1) * self.down + len(self.taps)),
                slice(first, last),
            )


def filter_record(
    record: JointRecord, bandwidths: Bandwidths, torque_lead: float = 0.0
) -> tuple[FilteredRun, ...]:
    """Return the runs of a record: gaps that are too long to be bridged separate them.

    Args:
        record: with any rate and jitter.
        bandwidths: of the filters.
        torque_lead: by how much a torque acted before its stamp, s. With viscous friction c2, a torque that is late by
            d makes a rotor inertia appear too small by c2 d.
    """
    rate = _rate(record.time)
    if bandwidths.position > 0.45 * rate or bandwidths.torque > 0.22 * rate:
        raise IdentificationError(
            f"{record.source}: bandwidths of {bandwidths.position:.4g} and {bandwidths.torque:.4g} Hz at "
            f"{rate:.4g} samples per second; accepted: up to {0.45 * rate:.4g} and {0.22 * rate:.4g} Hz"
        )
    # three time constants of the slowest pole
    edge = math.ceil(1.5 * rate / bandwidths.position) + _SPLINE_END
    shortest = 2 * edge + _kaiser(rate, bandwidths.torque)[0] + 1
    pieces = _pieces(record.time, BRIDGED_PERIODS / bandwidths.position)
    whole = [slice(*piece) for piece in pieces if piece[1] - piece[0] >= shortest]
    if not whole:
        raise IdentificationError(
            f"{record.source}: no stretch of {shortest / rate:.3g} s without a gap, which the filters' edges take; "
            "accepted: longer runs, or a higher --bandwidth"
        )
    return tuple(_filtered(record, piece, bandwidths, edge, torque_lead) for piece in whole)


def _filtered(
    record: JointRecord, piece: slice, bandwidths: Bandwidths, edge: int, torque_lead: float
) -> FilteredRun:
    time = record.time[piece]
    rate = _rate(time)
    even = _even(time, rate)
    inner = slice(edge, len(even) - edge)
    sections = butter(FILTER_ORDER, bandwidths.position, fs=rate, output="sos")
    stamps, position = _bridged(time, record.position[piece])
    position = _resampled(stamps, position, even, 5)
    smooth = sosfiltfilt(sections, position, axis=0, padlen=min(3 * edge, len(even) - 1))
    # From 0 on: stamps of the wall clock are rounded to 0.2 us, too coarse for second derivatives at 5 kHz.
    count = np.arange(len(even)) / rate
    curve = make_interp_spline(count, smooth, k=5)
    return FilteredRun(
        source=record.bag,
        names=record.names,
        time=even[inner],
        position=smooth[inner],
        velocity=curve(count[inner], 1),
        acceleration=curve(count[inner], 2),
        torque=_resampled(time - torque_lead, record.torque[piece], even, 1)[inner],
        bandwidths=bandwidths,
    )


def _rate(time: Array) -> float:
    """Return samples per second, gaps excluded."""
    if len(time) < 2:
        raise IdentificationError(
            f"a run of {counted(len(time), 'sample')}; accepted: a second of motion or more"
        )
    steps = np.diff(time)
    usual = steps[steps <= GAP_PERIODS * np.median(steps)]
    return float(len(usual) / usual.sum())


def gaps(time: Array) -> Index:
    """Return the indices of samples after a gap of more than 3.5 periods."""
    steps = np.diff(time)
    return (
        np.flatnonzero(steps > GAP_PERIODS * np.median(steps)) + 1
        if len(steps)
        else np.empty(0, dtype=np.intp)
    )


def _pieces(time: Array, bridged: float = 0.0) -> list[tuple[int, int]]:
    """Return first index and end of each piece without a gap that is longer than `bridged`."""
    breaks = [k for k in gaps(time).tolist() if time[k] - time[k - 1] > bridged]
    return list(pairwise([0, *breaks, len(time)]))


def _bridged(time: Array, values: Array) -> tuple[Array, Array]:
    """Return stamps and values with the samples that gaps lack, by cubics fitted to the samples on both sides.

    A spline through the samples alone would extrapolate their noise into a gap.
    """
    for k in reversed(gaps(time).tolist()):
        length = time[k] - time[k - 1]
        missing = np.linspace(
            0.0, 1.0, max(2, round(length / float(np.median(np.diff(time))))) + 1
        )[1:-1]
        reach = max(4, len(missing))
        near = slice(max(0, k - reach), k + reach)
        cubic = np.polynomial.polynomial.polyfit(
            (time[near] - time[k - 1]) / length, values[near], 3
        )
        between = np.polynomial.polynomial.polyval(missing, cubic).T
        values = np.insert(values, k, between, axis=0)
        time = np.insert(time, k, time[k - 1] + length * missing)
    return time, values


def _even(time: Array, rate: float) -> Array:
    return np.asarray(
        time[0] + np.arange(math.floor((time[-1] - time[0]) * rate + 1e-6) + 1) / rate
    )


def _resampled(time: Array, values: Array, even: Array, degree: int) -> Array:
    """Return values at even times; values whose stamps are even do not change."""
    tolerance = _STAMP_TOLERANCE * (even[1] - even[0]) + 2.0 * float(np.spacing(np.abs(time[-1])))
    if len(time) == len(even) and float(np.abs(time - even).max()) < tolerance:
        return values
    return make_interp_spline(time, values, k=degree)(even)


def low_pass_taps(rate: float, bandwidth: float) -> Array:
    """Return a symmetric low-pass, shape (2 h + 1,): full amplitude up to the bandwidth, none from twice it.

    Args:
        rate: samples per second.
        bandwidth: Hz.
    """
    count, beta = _kaiser(rate, bandwidth)
    return firwin(count, 1.5 * bandwidth, window=("kaiser", beta), fs=rate)


def _kaiser(rate: float, bandwidth: float) -> tuple[int, float]:
    """Return how many taps that low-pass has, and the parameter of its window."""
    count, beta = kaiserord(STOPBAND_DB, bandwidth / (0.5 * rate))
    return count | 1, beta


def low_pass(values: Array, taps: Array, down: int = 1) -> Array:
    """Return every down-th filtered sample, where the filter has its whole length.

    Args:
        values: shape (m, ...).
        taps: shape (2 h + 1,); the first returned sample belongs to index h.
        down: samples from one returned sample to the next.
    """
    count = max(0, (len(values) - len(taps)) // down + 1)
    columns = np.ascontiguousarray(values.reshape(len(values), -1).T)
    # zeros that put a result of the filter bank on the first whole length
    before = -(len(taps) - 1) % down
    first = (len(taps) - 1 + before) // down
    filtered = upfirdn(taps, np.pad(columns, ((0, 0), (before, 0))), 1, down)[
        :, first : first + count
    ]
    return filtered.T.reshape(count, *values.shape[1:])


def recording_notes(records: Sequence[JointRecord], bandwidths: Bandwidths) -> tuple[str, ...]:
    """Return in words how many gaps were interpolated or split runs."""
    notes = []
    longest = BRIDGED_PERIODS / bandwidths.position
    for record in records:
        steps = np.array([record.time[k] - record.time[k - 1] for k in gaps(record.time).tolist()])
        short = int(np.count_nonzero(steps <= longest))
        if short:
            notes.append(
                f"{record.source.name}: {counted(short, 'gap')} of up to {longest:.3g} s interpolated"
            )
        if short < len(steps):
            long = counted(len(steps) - short, "gap")
            notes.append(f"{record.source.name}: {long} of up to {steps.max():.3g} s split the run")
    return tuple(notes)
