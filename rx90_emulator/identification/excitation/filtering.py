"""Runs at an even rate, differentiated without delay, the common low-pass of torque and model, and excluded samples.

Positions pass a Butterworth filter forwards and backwards, which causes no delay; velocity and acceleration are the
derivatives of the quintic spline through the filtered samples (central differences lose a quarter of the velocity at a
fifth of the sampling rate, the spline less than a hundredth). The torque does not pass this filter: it passes one
low-pass together with all columns of the model (Gautier 1997, "Dynamic identification of robots with power model":
parallel filtering), so that the filter distorts both sides of the equation in the same way.

Gaps that are short compared with the bandwidth of the positions hide no motion that this filter passes: they are
bridged. During a shock the measured torque is not the arm's: it is replaced by a straight line, and so are the columns
of the model. A controller that misses its period for some milliseconds, for example, produces a torque of tens of Nm
for 10 to 15 ms, which the parallel filter would spread over a period of its bandwidth. Such a pulse stands far out of
the torque's usual scatter about its running median, and ends within 30 ms. Where a joint reverses, friction and
bristles cause pulses of their own: there a shock must be half as large as the range of the torque.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d
from scipy.signal import butter, firwin, kaiserord, sosfiltfilt, welch
from scipy.sparse import csr_array

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import fma, load, store
from rx90_emulator.identification.records import BagSource, JointRecord, block_means, stretches

_FILTER_ORDER = 4  # of the Butterworth filter, in each direction
_STOPBAND_DB = 60.0  # dB, of the parallel filter beyond twice its bandwidth
_SIGNAL_OVER_FLOOR = 10.0  # power of a motion over the noise of its positions at the edge of the passband
_MOVING_PEAK_OVER_FLOOR = 1e3  # power at its peak over that floor, above which a joint counts as moving
_MIN_SPECTRUM_SAMPLES = 64  # least length of a stretch for a spectrum
_SPECTRUM_TIME = 4.0  # s, of the pieces that spectra are averaged over
_POSITION_OVER_MOTION_BAND = 10.0  # least bandwidth of the positions over the motion's: Gautier's rule is 5 to 10
_MAX_BANDWIDTH_OVER_RATE = 0.3  # largest bandwidth of the positions over the sampling rate
_ROWS_PER_HZ = 2.5  # rows per second over the bandwidth of the torque: neighbours' noise is nearly independent
_MAX_ROWS = 30_000  # of all joints and runs: more rows improve the fit less than they slow it down
_SMOOTHED_FALL = 4.0**-6  # power of a torque at four times a frequency over that at it: a fall as f^-6
_GAP_PERIODS = 3.5  # periods without a sample that are a gap
_BRIDGED_PERIODS = 0.25  # longest gap, in periods of the positions' bandwidth, that does not split a run
_MIN_GAP_CONTEXT = 4  # samples on either side that a bridge's cubic is fitted to
_STAMP_TOLERANCE = 1e-3  # largest distance of a stamp from an even grid, in periods
_SPLINE_END = 10  # samples in which the error at a quintic spline's end fades
_BLOCK_SAMPLES = 8192  # samples whose columns are in memory at a time


class Bandwidths(NamedTuple):
    """Bandwidths of the two filters.

    Attributes:
        position: of the positions' Butterworth filter (both directions together: half the amplitude), Hz.
        torque: of the low-pass that torque and model share (half the amplitude at 1.5 times it), Hz.
        reason: how they follow from the data, in one sentence.
        recorded_velocity: whether velocity and acceleration come from recorded velocities instead of positions.
    """

    position: float
    torque: float
    reason: str = "as given"
    recorded_velocity: bool = False

    @classmethod
    def of(cls, records: Sequence[JointRecord]) -> Bandwidths:
        """Choose the bandwidths from records.

        The spectrum of a position falls with frequency until it meets the floor of its noise (encoder steps, mostly),
        which is flat. Below this frequency samples contain the motion; above it their second derivative is noise. The
        positions' bandwidth is where the power is ten times the floor, in the median of joints that move; at least ten
        times the band that holds 95 % of the velocity's power (Gautier's rule), and at most 0.3 times the sampling
        rate.
        The torque's bandwidth is a third of it: where its low-pass ends, the positions' filter has hardly begun (gain
        0.96). Long runs with hardly any noise would give more rows than a fit needs: then the torque's bandwidth is the
        one that gives 30,000 rows, but at least a third of ten times the motion's band. If torques were smoothed before
        they were recorded, the bandwidth is at most that of the smoothing (`smoothed_above`).
        """
        found = [pair for record in records for pair in _crossings(record)]
        if not found:
            longest = max(stop - start for record in records for start, stop in _pieces(record.time))
            if longest >= _MIN_SPECTRUM_SAMPLES:
                raise IdentificationError("no joint moves in any run; accepted: runs in which the joints move")
            samples = f"{longest} sample{'s' * (longest != 1)} without a gap"
            reason = f"{records[0].source}: {samples}; accepted: {_MIN_SPECTRUM_SAMPLES} or more in a run"
            raise IdentificationError(reason)
        crossing, motion = np.median(found, axis=0).tolist()
        suitable = max(crossing, _POSITION_OVER_MOTION_BAND * motion)
        position = min(suitable, _MAX_BANDWIDTH_OVER_RATE * min(_rate(record.time) for record in records))
        source = f"the motion stands out of the positions' noise up to {crossing:.3g} Hz"
        if suitable > crossing:
            source += f", and {_POSITION_OVER_MOTION_BAND:g} times its own band is {suitable:.3g} Hz"
        if position < suitable:
            source += f"; no more than {_MAX_BANDWIDTH_OVER_RATE:g} of the sampling rate"
        torque = position / 3.0
        lasting = sum(record.time[-1] - record.time[0] for record in records) * records[0].position.shape[1]
        least = min(_POSITION_OVER_MOTION_BAND * motion / 3.0, torque)
        carried = max(_MAX_ROWS / (_ROWS_PER_HZ * float(lasting)), least)
        gets = f"what {_MAX_ROWS} rows carry" if carried < torque else "a third of it"
        torque = min(carried, torque)
        edge = smoothed_above(records)
        if edge is not None and edge < torque:
            torque = edge
            gets = f"{edge:.3g} Hz, for above it falls too steeply: it was smoothed before"
        return cls(position, torque, f"{source}; the torque gets {gets}")

    def at_most(self, highest: float, of: str) -> Bandwidths:
        """Return these with a positions' bandwidth of at most `highest`, Hz, and a third of that for the torque's.

        The torque's stays where it is less: beyond it, a torque that was smoothed is not the arm's. `of` names the
        bound.
        """
        if self.position <= highest:
            return self
        reason = f"{self.reason}; no more than {of}"
        return self._replace(position=highest, torque=min(self.torque, highest / 3.0), reason=reason)


def _crossings(record: JointRecord) -> Iterator[tuple[float, float]]:
    """Yield for each moving joint the frequency where its spectrum meets the noise, and its velocity's band, Hz."""
    frequency, power, edges = _spectrum(record, record.position, 3, "hann")
    for column in power.T:
        floor = max(float(np.median(column[frequency > 0.25 * _rate(record.time)])), 1e-30)
        typical = np.array([np.median(part) for part in np.split(column, edges[1:])])
        peak = int(np.argmax(typical))
        below_floor = np.flatnonzero(typical[peak:] < _SIGNAL_OVER_FLOOR * floor)
        if typical[peak] > _MOVING_PEAK_OVER_FLOOR * floor:
            crossing = float(frequency[edges[peak + below_floor[0]] if len(below_floor) else -1])
            velocity = np.cumsum(np.where(frequency < crossing, column, 0.0) * frequency**2)
            yield crossing, float(frequency[np.searchsorted(velocity, 0.95 * velocity[-1])])


def least_bandwidth(records: Sequence[JointRecord]) -> float:
    """Return ten times the band of the joints' motion in records, Hz: the least bandwidth for the positions."""
    return _POSITION_OVER_MOTION_BAND * float(np.median([pair[1] for one in records for pair in _crossings(one)]))


def smoothed_above(records: Sequence[JointRecord]) -> float | None:
    """Return the frequency above which torques were smoothed before they were recorded, Hz; None if they were not.

    Coulomb friction steps, and noise is flat: the power of a measured torque falls with the square of the frequency at
    most, apart from the edge of the motion's band. A zero-phase low-pass of second order falls with the eighth power. A
    torque counts as smoothed if for at least half of the joints of all runs the power falls faster than with the sixth
    power from some frequency to four times it; at the least such frequency the low-pass has hardly begun.
    """
    found = []
    for record in records:
        # The leakage of this window, 92 dB below the peak, hides no fall.
        frequency, power, edges = _spectrum(record, record.torque, 1, "blackmanharris")
        band = frequency[edges]
        for column in power.T:
            typical = np.array([np.median(part) for part in np.split(column, edges[1:])])
            fourfold = np.interp(4.0 * band, band, np.log(np.maximum(typical, 1e-300)), right=np.inf)
            # Below the fourth frequency the window itself falls.
            steep = (fourfold < np.log(np.maximum(typical, 1e-300) * _SMOOTHED_FALL)) & (band >= frequency[4])
            found.append(float(band[steep][0]) if steep.any() else np.inf)
    edge = float(np.median(found)) if found else np.inf
    return edge if np.isfinite(edge) else None


def _spectrum(record: JointRecord, values: Array, degree: int, window: str) -> tuple[Array, Array, Index]:
    """Return frequencies, power of each column, and the first indices of bands, of the longest piece without a gap.

    Bands are at least a fifth of an octave wide: the median in a band ignores lines of ripple. All results are empty
    for a piece that is too short.
    """
    start, stop = max(_pieces(record.time), key=lambda piece: piece[1] - piece[0])
    if stop - start < _MIN_SPECTRUM_SAMPLES:
        return np.empty(0), np.empty((0, 0)), np.empty(0, dtype=np.intp)
    time = record.time[start:stop]
    rate = _rate(record.time[start:stop])
    even = _even(time, rate)
    segment = min(len(even), max(_MIN_SPECTRUM_SAMPLES, round(_SPECTRUM_TIME * rate)))
    resampled = _resampled(time, values[start:stop], even, degree)
    frequency, power = welch(resampled, rate, window, nperseg=segment, axis=0)
    band = np.unique(np.round(5.0 * np.log2(np.maximum(np.arange(len(frequency)), 1))), return_inverse=True)[1]
    return frequency, power, np.flatnonzero(np.diff(band, prepend=-1))


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """One run at its full, even rate, without the ends that the filters distort.

    A torque step at a reversal is resampled to a value between both levels, in one sample near it. The columns of the
    model must be resampled in the same way: from the velocity at the s stamps of the torque.

    Attributes:
        source: the bag.
        names: n joints.
        time: s, even, shape (m,).
        position: rad, zero-phase filtered, shape (m, n).
        velocity: rad/s, derivative of the filtered position, shape (m, n).
        acceleration: rad/s^2, its second derivative, shape (m, n).
        torque: as recorded, at the joints, Nm, shape (m, n).
        torque_velocity: velocity where the torque was recorded, rad/s, shape (s, n).
        reference: position set-points, rad, shape (m, n); None where none were recorded.
        bandwidths: of both filters.
        resampling: linear interpolation from the stamps to `time`, sparse, shape (m, s); None if they are the same.
        shocks: begin and end of the times whose torque is not used, s.
    """

    source: BagSource
    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    torque_velocity: Array
    reference: Array | None
    bandwidths: Bandwidths
    resampling: csr_array | None = None
    shocks: tuple[tuple[float, float], ...] = ()

    @cached_property
    def rate(self) -> float:
        """Return samples per second."""
        return _rate(self.time)

    @cached_property
    def down(self) -> int:
        """Return how many samples lie between two rows."""
        # Parts of the same recording have rates that differ by rounding; their rows must not differ.
        return max(1, math.floor(self.rate / (_ROWS_PER_HZ * self.bandwidths.torque) + 1e-6))

    @cached_property
    def taps(self) -> Array:
        """Return the parallel filter, shape (2 h + 1,): Kaiser window, -60 dB beyond twice the bandwidth."""
        return low_pass_taps(self.rate, self.bandwidths.torque)

    @cached_property
    def rows(self) -> Index:
        """Return the samples of the rows, those with a whole length of the filter around them, shape (k,)."""
        half = len(self.taps) // 2
        return np.arange(half, len(self.time) - half, self.down)

    @property
    def whole(self) -> Mask:
        """Return the rows that lie outside of all shocks, by a quarter of a period of the torque's bandwidth, (k,)."""
        time = self.time[self.rows]
        margin = 0.25 / self.bandwidths.torque
        inside = [(time > begin - margin) & (time < end + margin) for begin, end in self.shocks]
        return np.asarray(~np.any([np.zeros(len(time), dtype=np.bool_), *inside], axis=0))

    def evened(self, values: Array) -> Array:
        """Resample values from where the torque was recorded, (s, ...), to the run's samples, (m, ...)."""
        if self.resampling is None:
            return values
        even = self.resampling @ values.reshape(len(values), -1)
        return np.asarray(even).reshape(len(even), *values.shape[1:])

    def parallel(self, values: Array) -> Array:
        """Return values at the full rate, (m, ...), with the torque's low-pass, at the rows, shape (k, ...)."""
        return low_pass(values, self.taps, self.down)

    def smooth(self, values: Array, bandwidth: float) -> Array:
        """Return values at the full rate, low-passed without delay at another bandwidth, Hz, shape (m, n)."""
        sections = butter(_FILTER_ORDER, bandwidth, fs=self.rate, output="sos")
        return np.asarray(sosfiltfilt(sections, values, axis=0))

    def blocks(self) -> Iterator[tuple[slice, slice]]:
        """Yield pairs of samples and of the rows that `parallel` makes of them, so that memory stays bounded."""
        count = len(self.rows)
        size = max(1, _BLOCK_SAMPLES // self.down)
        for first in range(0, count, size):
            last = min(first + size, count)
            yield slice(first * self.down, (last - 1) * self.down + len(self.taps)), slice(first, last)


def filter_record(
    record: JointRecord, bandwidths: Bandwidths, reference: Array | None = None, torque_lead: float = 0.0
) -> tuple[FilteredRun, ...]:
    """Return the runs of a record: gaps that are too long to be bridged separate them.

    Args:
        record: with any rate and jitter.
        bandwidths: of the filters.
        reference: position set-points at the record's samples, shape (m, n).
        torque_lead: by how much a torque acted before its stamp, s. With viscous friction c2, a torque that is late by
            d makes a rotor inertia appear too small by c2 d.
    """
    rate = _rate(record.time)
    if bandwidths.position > 0.45 * rate or bandwidths.torque > 0.22 * rate:
        raise IdentificationError(
            f"{record.source}: bandwidths of {bandwidths.position:.4g} and {bandwidths.torque:.4g} Hz at "
            f"{rate:.4g} samples per second; accepted: up to {0.45 * rate:.4g} and {0.22 * rate:.4g} Hz"
        )
    edge = math.ceil(1.5 * rate / bandwidths.position) + _SPLINE_END  # three time constants of the slowest pole
    shortest = 2 * edge + _kaiser(rate, bandwidths.torque)[0] + 1
    bridged = bridged_gap(bandwidths)
    pieces = [slice(*piece) for piece in _pieces(record.time, bridged) if piece[1] - piece[0] >= shortest]
    if not pieces:
        raise IdentificationError(
            f"{record.source}: no stretch of {shortest / rate:.3g} s without a gap, which the filters' edges take; "
            "accepted: longer runs, or higher bandwidths"
        )
    return tuple(_filtered(record, piece, bandwidths, edge, reference, torque_lead) for piece in pieces)


def _filtered(
    record: JointRecord, piece: slice, bandwidths: Bandwidths, edge: int, reference: Array | None, torque_lead: float
) -> FilteredRun:
    time = record.time[piece]
    rate = _rate(time)
    even = _even(time, rate)
    inner = slice(edge, len(even) - edge)
    sections = butter(_FILTER_ORDER, bandwidths.position, fs=rate, output="sos")
    # From 0 on: stamps of the wall clock are rounded to 0.2 us, too coarse for second derivatives at 5 kHz.
    count = np.arange(len(even)) / rate

    def smoothed(values: Array) -> Array:
        resampled = _resampled(*_bridged(time, values[piece]), even, 5)
        return np.asarray(sosfiltfilt(sections, resampled, axis=0, padlen=min(3 * edge, len(even) - 1)))

    position = smoothed(record.position)
    order = int(not bandwidths.recorded_velocity)
    curve = make_interp_spline(count, position if order else smoothed(record.velocity), k=5)
    ours = np.full(len(time), fill_value=True)
    for begin, end in record.shocks:
        ours &= (time < begin) | (time > end)
    stamps = time[ours] - torque_lead
    torque = record.torque[piece][ours]
    samples = even[inner]
    velocity = np.asarray(curve(count[inner], order))
    resampling = None
    torque_velocity = velocity
    if not _is_even(stamps, even):
        first = np.searchsorted(stamps, samples[0], "right") - 1
        last = np.searchsorted(stamps, samples[-1]) + 1
        around = stamps[max(int(first), 0) : last]
        resampling = BSpline.design_matrix(samples, np.pad(around, 1, "edge"), 1, extrapolate=True)
        torque_velocity = np.asarray(curve(around - even[0], order))
    return FilteredRun(
        source=record.bag,
        names=record.names,
        time=samples,
        position=position[inner],
        velocity=velocity,
        acceleration=np.asarray(curve(count[inner], order + 1)),
        torque=_resampled(stamps, torque, even, 1)[inner],
        torque_velocity=torque_velocity,
        reference=None if reference is None else _resampled(*_bridged(time, reference[piece]), even, 5)[inner],
        bandwidths=bandwidths,
        resampling=resampling,
        shocks=record.shocks,
    )


def _rate(time: Array) -> float:
    """Return samples per second, gaps excluded."""
    if len(time) < 2:
        raise IdentificationError(f"a run of {counted(len(time), 'sample')}; accepted: a second of motion or more")
    steps = np.diff(time)
    usual = steps[steps < _GAP_PERIODS * np.median(steps)]
    return float(len(usual) / usual.sum())


def gaps(time: Array) -> Index:
    """Return the indices of samples after a gap of more than 3.5 periods."""
    steps = np.diff(time)
    return np.flatnonzero(steps > _GAP_PERIODS * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)


def bridged_gap(bandwidths: Bandwidths) -> float:
    """Return the longest gap that is bridged, s."""
    return _BRIDGED_PERIODS / bandwidths.position


def _pieces(time: Array, bridged: float = 0.0) -> list[tuple[int, int]]:
    """Return first index and end of each piece without a gap that is longer than `bridged`."""
    breaks = [k for k in gaps(time).tolist() if time[k] - time[k - 1] > bridged]
    return list(pairwise([0, *breaks, len(time)]))


def _bridged(time: Array, values: Array) -> tuple[Array, Array]:
    """Return stamps and values with the samples that gaps lack, by cubics fitted to the samples on both sides.

    A spline through the samples alone would extrapolate their noise into a gap.
    """
    added: list[tuple[int, Array, Array]] = []
    for k in gaps(time).tolist():
        begin = time[k - 1]
        end = time[k]
        period = float(np.median(np.diff(time)))
        missing = np.linspace(begin, end, max(2, round((end - begin) / period)) + 1)[1:-1]
        reach = max(_MIN_GAP_CONTEXT, len(missing))
        near = slice(max(0, k - reach), k + reach)
        powers = np.vander((time[near] - begin) / (end - begin), 4)
        cubic = np.linalg.lstsq(powers, values[near], rcond=None)[0]
        added.append((k, missing, np.vander((missing - begin) / (end - begin), 4) @ cubic))
    if not added:
        return time, values
    places = np.concatenate([np.full(len(missing), k) for k, missing, _ in added])
    between = [np.concatenate(parts) for parts in list(zip(*added, strict=True))[1:]]
    return np.insert(time, places, between[0]), np.insert(values, places, between[1], axis=0)


def _even(time: Array, rate: float) -> Array:
    return np.asarray(time[0] + np.arange(math.floor((time[-1] - time[0]) * rate + 1e-6) + 1) / rate)


def _resampled(time: Array, values: Array, even: Array, degree: int) -> Array:
    """Return values at even times; values whose stamps are even do not change."""
    return values if _is_even(time, even) else np.asarray(make_interp_spline(time, values, k=degree)(even))


def _is_even(time: Array, even: Array) -> bool:
    """Return whether stamps are at even times, except for rounding."""
    tolerance = _STAMP_TOLERANCE * (even[1] - even[0]) + 2.0 * float(np.spacing(np.abs(time[-1])))
    return len(time) == len(even) and float(np.abs(time - even).max()) < tolerance


def low_pass_taps(rate: float, bandwidth: float) -> Array:
    """Return a symmetric low-pass, shape (2 h + 1,): full amplitude up to the bandwidth, none from twice it.

    Args:
        rate: samples per second.
        bandwidth: Hz.
    """
    count, beta = _kaiser(rate, bandwidth)
    return np.asarray(firwin(count, 1.5 * bandwidth, window=("kaiser", beta), fs=rate))


def _kaiser(rate: float, bandwidth: float) -> tuple[int, float]:
    """Return how many taps that low-pass has, and the parameter of its window."""
    count, beta = kaiserord(_STOPBAND_DB, bandwidth / (0.5 * rate))
    return count | 1, beta


def low_pass(values: Array, taps: Array, down: int = 1) -> Array:
    """Return every down-th filtered sample, where the filter has its whole length.

    Args:
        values: shape (m, ...).
        taps: shape (2 h + 1,); the first returned sample belongs to index h.
        down: samples from one returned sample to the next.
    """
    count = max(0, (len(values) - len(taps)) // down + 1)
    result = np.empty((count, math.prod(values.shape[1:])))
    filter_columns(np.ascontiguousarray(values.reshape(len(values), -1).T), taps, down, result)
    return result.reshape(count, *values.shape[1:])


@kernel
def filter_columns(columns: Array, taps: Array, down: int, result: Array) -> None:
    """Filter samples of several columns.

    Args:
        columns: at the full rate, shape (c, m).
        taps: weights of the samples, shape (t,).
        down: samples from one result to the next.
        result: receives the sums, shape (k, c); the first sum begins at sample 0.
    """
    whole = len(taps) - len(taps) % 16
    parts = np.empty(8)
    for number in range(len(columns)):
        for row in range(len(result)):
            samples = columns[number, row * down :]
            parts[:] = 0.0
            even = load(parts, 8)
            odd = load(parts, 8)
            for tap in range(0, whole, 16):
                even = fma(load(taps[tap:], 8), load(samples[tap:], 8), even)
                odd = fma(load(taps[tap + 8 :], 8), load(samples[tap + 8 :], 8), odd)
            store(parts, even + odd)
            total = 0.0
            for part in parts:
                total += part
            for tap in range(whole, len(taps)):
                total += taps[tap] * samples[tap]
            result[row, number] = total


_SHOCK_RATE = 250.0  # approximate rate for the search of shocks, samples per second: means of 4 ms
_SHOCK_WINDOW = 0.06  # s, of the running median: pulses of up to half of it stand out
_SHOCK_OVER_SCATTER = 6.0  # least size over the 97.5th percentile of the scatter
# least size over the torque's range; at reversals
_SHOCK_OVER_RANGE = 0.1
_REVERSING_SHOCK_OVER_RANGE = 0.5
_SHOCK_MARGIN = 5e-3  # s, excluded on both sides, too
_LOW_RATE = 67.0  # samples per second, of the slowest recordings for which intervals were validated
SLOW_SPEED, SLOW_SHARE = 0.05, 0.1
"""Below one of these speeds an element is near a reversal or at rest: rad/s; share of the speed that is exceeded in a
tenth of the run.

On real arms, rows below it bias Coulomb friction low by 10 to 25 %.
"""


def without_shocks(record: JointRecord, elements: Array) -> tuple[JointRecord, tuple[str, ...]]:
    """Return a record with the times of its shocks, and the findings in words.

    Args:
        record: of n joints.
        elements: E, joint velocities to those of the friction elements, shape (n_el, n).
    """
    rate = (len(record.time) - 1) / max(float(record.time[-1] - record.time[0]), 1e-9)
    size = max(1, round(rate / _SHOCK_RATE))
    time = block_means(record.time, size)
    velocity = block_means(record.velocity, size)
    torque = block_means(record.torque, size)
    width = round(_SHOCK_WINDOW * rate / size) // 2 * 2 + 1
    if width < 5 or len(time) <= width:  # a pulse would be one sample or none
        return record, ()
    distance = np.abs(torque - median_filter(torque, size=(width, 1), mode="nearest"))
    reverses = _near_rest(velocity @ elements.T, width) @ (elements != 0.0)
    low, high = np.percentile(torque, (1.0, 99.0), axis=0)
    far = np.zeros(distance.shape, dtype=np.bool_)
    for here, share in ((~reverses, _SHOCK_OVER_RANGE), (reverses, _REVERSING_SHOCK_OVER_RANGE)):
        for joint, rows in enumerate(here.T):
            if rows.any():
                usual = float(np.percentile(distance[rows, joint], 97.5))
                least = max(_SHOCK_OVER_SCATTER * usual, share * float(high[joint] - low[joint]))
                far[:, joint] |= rows & (distance[:, joint] > least)
    found: list[tuple[float, float]] = []
    texts = []
    half = 0.5 * size / rate
    for start, stop in stretches(np.asarray(far.any(axis=1))):
        joint = int(np.argmax(np.where(far[start:stop], distance[start:stop], 0.0).max(axis=0)))
        begin = float(time[start]) - half - _SHOCK_MARGIN
        end = float(time[stop - 1]) + half + _SHOCK_MARGIN
        if found and begin <= found[-1][1]:
            found[-1] = (found[-1][0], end)
            continue
        found.append((begin, end))
        height = float(distance[start:stop, joint].max())
        texts.append(f"{height:.3g} Nm at {record.names[joint]} {begin - float(record.time[0]):.3g} s after the begin")
    if not found:
        return record, ()
    removed = 1e3 * sum(end - begin for begin, end in found)
    shown = ", ".join(texts[:6]) + (", ..." if len(texts) > 6 else "")
    what = f"{len(found)} shock{'s' * (len(found) > 1)}"
    text = f"{record.source.name}: {what} of the torque left out, {removed:.0f} ms with margins: {shown}"
    return replace(record, shocks=tuple(found)), (text,)


def _near_rest(velocity: Array, width: int) -> Mask:
    """Return the samples at which elements are slow or reverse within a window of `width` samples, shape (m, n_el)."""
    least = np.minimum(SLOW_SPEED, SLOW_SHARE * np.quantile(np.abs(velocity), 0.9, axis=0))
    turns = np.sign(minimum_filter1d(velocity, width, axis=0)) != np.sign(maximum_filter1d(velocity, width, axis=0))
    return np.asarray(maximum_filter1d((np.abs(velocity) < least) | turns, width, axis=0))


def recording_notes(records: Sequence[JointRecord], bandwidths: Bandwidths) -> tuple[str, ...]:
    """Return, in words, which gaps are bridged or split runs, that torques were smoothed, and which rates are low."""
    found = []
    longest = bridged_gap(bandwidths)
    for record in records:
        steps = np.array([record.time[k] - record.time[k - 1] for k in gaps(record.time).tolist()])
        short = steps[steps <= longest]
        name = record.source.name
        if len(short):
            found.append(
                f"{name}: {len(short)} gap{'s' * (len(short) > 1)} of up to {1e3 * short.max():.3g} ms interpolated, "
                f"short beside the bandwidth of {bandwidths.position:.3g} Hz"
            )
        if len(short) < len(steps):
            found.append(
                f"{name}: {len(steps) - len(short)} gap{'s' * (len(steps) - len(short) > 1)} of up to "
                f"{steps.max():.3g} s split the run; up to {1e3 * longest:.3g} ms would be interpolated"
            )
        rate = (len(record.time) - 1 - len(steps)) / (record.time[-1] - record.time[0] - steps.sum())
        if rate < _LOW_RATE:
            found.append(
                f"warning: {name}: {rate:.3g} samples per second do not resolve motion above {0.3 * rate:.3g} Hz, nor "
                f"what is over within {1e3 * 2.0 / rate:.0f} ms of a reversal, such as stiff bristles (c0, c1) and "
                "narrow Stribeck rises (those that are found last longer); deviations are proven from "
                f"{_LOW_RATE:g} samples per second on"
            )
    if (edge := smoothed_above(records)) is not None:
        found.append(
            f"the torques were smoothed before they were recorded, from about {edge:.2g} Hz on: what reversals and "
            "faster motion tell is lost, and their noise, which chi^2 compares with, is unknown"
        )
    return tuple(found)
