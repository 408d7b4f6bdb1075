"""Runs at an even rate, differentiated without delay, the low-pass that torque and model share, and what is left out.

Positions pass a Butterworth filter forwards and backwards, which delays nothing; velocity and acceleration are the
derivatives of the quintic spline through the filtered samples (central differences lose a quarter of the velocity at a
fifth of the sampling rate, the spline less than a hundredth). The torque is not filtered with them: it passes one
low-pass together with everything that is to explain it (Gautier 1997, "Dynamic identification of robots with power
model": parallel filtering), so that the filter distorts both sides of the equation alike.

Gaps that are short beside the bandwidth of the positions hide no motion that it lets pass: they are bridged. The
samples of a shock are no torque of the arm's: that torque is bridged, too, by a straight line, as is what is to explain
it. A controller that loses its beat for some milliseconds gives such a torque, tens of Nm for 10 to 15 ms, and the
parallel filter would spread it over a period of its bandwidth. The pulse stands far out of the
torque's usual scatter about its running median, and is over within 30 ms. Where a joint reverses, friction and bristles
give pulses of their own: there it must be half as large as all that the torque does.
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
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import fma, load, store
from rx90_emulator.identification.records import BagSource, JointRecord

_FILTER_ORDER = 4  # of the Butterworth filter, in each direction
_STOPBAND_DB = 60.0  # dB, of the parallel filter beyond twice its bandwidth
_SIGNAL_OVER_FLOOR = 10.0  # power of a motion over the noise of its positions, up to which the filter lets it pass
_MOVING_PEAK_OVER_FLOOR = 1e3  # power at its peak over that floor, from which a joint counts as moving
_MIN_SPECTRUM_SAMPLES = 64  # samples of a stretch whose spectrum is looked at
_SPECTRUM_TIME = 4.0  # s, of the pieces that spectra are averaged over
_POSITION_OVER_MOTION_BAND = 10.0  # bandwidth of the positions over the motion's, at least: Gautier's rule is 5 to 10
_MAX_BANDWIDTH_OVER_RATE = 0.3  # bandwidth of the positions over the sampling rate, at most
_ROWS_PER_HZ = 2.5  # rows per second over the bandwidth of the torque: neighbours' noise is nearly independent
_MAX_ROWS = 30_000  # of all joints and runs: what more of them tell is not worth the time of their fits
_SMOOTHED_FALL = 4.0**-6  # power of a torque at four times a frequency over that at it: a fall as f^-6
_GAP_PERIODS = 3.5  # periods without a sample that are a gap
_BRIDGED_PERIODS = 0.25  # periods of the positions' bandwidth that a gap may last, not to split a run
_LEAST_BESIDE_GAP = 4  # samples on either side that tell a bridge's cubic
_STAMP_TOLERANCE = 1e-3  # periods that a stamp may lie off an even grid, to be taken as on it
_SPLINE_END = 10  # samples in which the error at a quintic spline's end fades
_BLOCK_SAMPLES = 8192  # samples whose columns are held at a time


class Bandwidths(NamedTuple):
    """Of the two filters.

    Attributes:
        position: of the positions' Butterworth filter (both directions together: half the amplitude), Hz.
        torque: of the low-pass that torque and model share (half the amplitude at 1.5 times it), Hz.
        reason: what in the data they come from, one sentence.
        recorded_velocity: whether velocity and acceleration come from recorded velocities in place of positions.
    """

    position: float
    torque: float
    reason: str = "as given"
    recorded_velocity: bool = False

    @classmethod
    def of(cls, records: Sequence[JointRecord]) -> Bandwidths:
        """Choose them from records.

        The spectrum of a position falls with frequency until it meets the floor of its noise (encoder steps, mostly),
        which is flat. Below, samples tell of the motion; above, their second derivative is noise. The positions'
        bandwidth is where the power is ten times the floor, in the median of joints that move; at least ten times the
        band that holds 95 % of the velocity's power (Gautier's rule), and at most 0.3 times the sampling rate. The
        torque gets a third of it: where its low-pass ends, the positions' filter has hardly begun (gain 0.96). Long
        runs with hardly any noise would give more rows than a fit needs: then the torque gets what 30,000 rows carry,
        down to a third of ten times the motion's band. Torques that were smoothed before they were recorded get no
        more than that smoothing left (`smoothed_above`).

        Raises:
            IdentificationError: if no joint moves, or the runs are too short.
        """
        found = [pair for record in records for pair in _crossings(record)]
        if not found:
            longest = max(stop - start for record in records for start, stop in _pieces(record.time))
            if longest >= _MIN_SPECTRUM_SAMPLES:
                raise IdentificationError("no joint moves in any run; accepted: runs in which the joints move")
            samples = f"{longest} sample{'s' * (longest != 1)} without a gap"
            said = f"{records[0].source}: {samples}; accepted: {_MIN_SPECTRUM_SAMPLES} or more in a run"
            raise IdentificationError(said)
        crossing, motion = np.median(found, axis=0).tolist()
        wanted = max(crossing, _POSITION_OVER_MOTION_BAND * motion)
        position = min(wanted, _MAX_BANDWIDTH_OVER_RATE * min(_rate(record.time) for record in records))
        source = f"the motion stands out of the positions' noise up to {crossing:.3g} Hz"
        if wanted > crossing:
            source += f", and {_POSITION_OVER_MOTION_BAND:g} times its own band is {wanted:.3g} Hz"
        if position < wanted:
            source += f"; no more than {_MAX_BANDWIDTH_OVER_RATE:g} of the sampling rate"
        torque = position / 3.0
        lasting = sum(record.time[-1] - record.time[0] for record in records) * records[0].position.shape[1]
        least = min(_POSITION_OVER_MOTION_BAND * motion / 3.0, torque)
        carried = max(_MAX_ROWS / (_ROWS_PER_HZ * float(lasting)), least)
        gets = f"what {_MAX_ROWS} rows carry" if carried < torque else "a third of it"
        torque, edge = min(carried, torque), smoothed_above(records)
        if edge is not None and edge < torque:
            torque, gets = edge, f"{edge:.3g} Hz, for above it falls too steeply: it was smoothed before"
        return cls(position, torque, f"{source}; the torque gets {gets}")


def _crossings(record: JointRecord) -> Iterator[tuple[float, float]]:
    """Yield, for each joint that moves, where its spectrum meets the noise, and the band of its velocity, Hz."""
    frequency, power, edges = _spectrum(record, record.position, 3, "hann")
    for column in power.T:
        floor = max(float(np.median(column[frequency > 0.25 * _rate(record.time)])), 1e-30)
        typical = np.array([np.median(part) for part in np.split(column, edges[1:])])
        peak = int(np.argmax(typical))
        lost = np.flatnonzero(typical[peak:] < _SIGNAL_OVER_FLOOR * floor)
        if typical[peak] > _MOVING_PEAK_OVER_FLOOR * floor:
            crossing = float(frequency[edges[peak + lost[0]] if len(lost) else -1])
            velocity = np.cumsum(np.where(frequency < crossing, column, 0.0) * frequency**2)
            yield crossing, float(frequency[np.searchsorted(velocity, 0.95 * velocity[-1])])


def least_bandwidth(records: Sequence[JointRecord]) -> float:
    """Return ten times the band of the motion of records in which joints move, Hz: what the positions need at least."""
    return _POSITION_OVER_MOTION_BAND * float(np.median([pair[1] for one in records for pair in _crossings(one)]))


def smoothed_above(records: Sequence[JointRecord]) -> float | None:
    """Return from where on torques were smoothed before they were recorded, Hz; None where they were not.

    Coulomb friction steps, and noise is flat: the power of a measured torque falls with the square of the frequency at
    most, beside the motion's own edge. A zero-phase low-pass of second order falls with its eighth power. A torque
    counts as smoothed where, of the joints of all runs, half or more have a power that falls from some frequency to
    four times that by more than with the sixth power; the least such frequency is where the low-pass has hardly begun.
    """
    found = []
    for record in records:
        # Of the leakage of this window, 92 dB below the peak, nothing hides a fall.
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
    """Return frequencies, power of each column, and where bands of them begin, of the longest piece without a gap.

    Bands are a fifth of an octave wide at least: the median in a band ignores lines of ripple. All are empty for a
    piece that is too short.
    """
    start, stop = max(_pieces(record.time), key=lambda piece: piece[1] - piece[0])
    if stop - start < _MIN_SPECTRUM_SAMPLES:
        return np.empty(0), np.empty((0, 0)), np.empty(0, dtype=np.intp)
    time, rate = record.time[start:stop], _rate(record.time[start:stop])
    even = _even(time, rate)
    segment = min(len(even), max(_MIN_SPECTRUM_SAMPLES, round(_SPECTRUM_TIME * rate)))
    resampled = _resampled(time, values[start:stop], even, degree)
    frequency, power = welch(resampled, rate, window, nperseg=segment, axis=0)
    band = np.unique(np.round(5.0 * np.log2(np.maximum(np.arange(len(frequency)), 1))), return_inverse=True)[1]
    return frequency, power, np.flatnonzero(np.diff(band, prepend=-1))


class TorqueStamps(NamedTuple):
    """Where the torque was recorded, if that is not at a run's even times, and its way from there to these.

    A torque that steps at a reversal is resampled to something between both its values, in one sample near it. What is
    to explain it must go the same way: from the velocity at the stamps, resampled as the torque was.

    Attributes:
        velocity: of the joints at s stamps, rad/s, shape (s, n).
        resampling: linear interpolation from the stamps to the run's samples, sparse, shape (m, s).
    """

    velocity: Array
    resampling: csr_array


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """One run at its full, even rate; what the filter's edges spoil is cut off.

    Attributes:
        source: the bag.
        names: n joints.
        time: s, even, shape (m,).
        position: rad, zero-phase filtered, shape (m, n).
        velocity: rad/s, derivative of the filtered position, shape (m, n).
        acceleration: rad/s^2, its second derivative, shape (m, n).
        torque: as recorded, at the joints, Nm, shape (m, n).
        reference: position set-points, rad, shape (m, n); None where none were recorded.
        bandwidths: of both filters.
        stamps: where the torque was recorded; None where that is at `time`.
        shocks: begin and end of times whose torque is not used, s.
    """

    source: BagSource
    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    reference: Array | None
    bandwidths: Bandwidths
    stamps: TorqueStamps | None = None
    shocks: tuple[tuple[float, float], ...] = ()

    @cached_property
    def rate(self) -> float:
        """Return samples per second."""
        return _rate(self.time)

    @cached_property
    def down(self) -> int:
        """Return how many samples lie between two rows."""
        # Rates of the same recording, cut elsewhere, differ by rounding: its rows must not.
        return max(1, math.floor(self.rate / (_ROWS_PER_HZ * self.bandwidths.torque) + 1e-6))

    @cached_property
    def taps(self) -> Array:
        """Return the parallel filter, shape (2 h + 1,): Kaiser window, -60 dB beyond twice the bandwidth."""
        return low_pass_taps(self.rate, self.bandwidths.torque)

    @cached_property
    def rows(self) -> Index:
        """Return the samples that the rows lie at, shape (k,): those around which the filter has its whole length."""
        half = len(self.taps) // 2
        return np.arange(half, len(self.time) - half, self.down)

    @property
    def whole(self) -> Mask:
        """Return which rows lie outside of the shocks, by a quarter of a period of the torque's bandwidth, (k,)."""
        time, margin = self.time[self.rows], 0.25 / self.bandwidths.torque
        inside = [(time > begin - margin) & (time < end + margin) for begin, end in self.shocks]
        return np.asarray(~np.any([np.zeros(len(time), dtype=np.bool_), *inside], axis=0))

    @property
    def torque_velocity(self) -> Array:
        """Return the joints' velocities where the torque was recorded, rad/s, shape (s, n)."""
        return self.velocity if self.stamps is None else self.stamps.velocity

    def evened(self, values: Array) -> Array:
        """Return at the run's samples what is known where the torque was recorded, shapes (m, ...) and (s, ...)."""
        if self.stamps is None:
            return values
        even = self.stamps.resampling @ values.reshape(len(values), -1)
        return np.asarray(even).reshape(len(even), *values.shape[1:])

    def parallel(self, values: Array) -> Array:
        """Return values at the full rate, shape (m, ...), low-passed as the torque is, at the rows, shape (k, ...)."""
        return low_pass(values, self.taps, self.down)

    def smooth(self, values: Array, bandwidth: float) -> Array:
        """Return values at the full rate without delay below another bandwidth, Hz, shape (m, n)."""
        sections = butter(_FILTER_ORDER, bandwidth, fs=self.rate, output="sos")
        return np.asarray(sosfiltfilt(sections, values, axis=0))

    def blocks(self) -> Iterator[tuple[slice, slice]]:
        """Yield pairs of samples and of the rows that `parallel` makes of them, so that memory stays bounded."""
        count, size = len(self.rows), max(1, _BLOCK_SAMPLES // self.down)
        for first in range(0, count, size):
            last = min(first + size, count)
            yield slice(first * self.down, (last - 1) * self.down + len(self.taps)), slice(first, last)


def filter_record(
    record: JointRecord, bandwidths: Bandwidths, reference: Array | None = None, torque_lead: float = 0.0
) -> tuple[FilteredRun, ...]:
    """Return the runs of a record: a gap that is not short beside the bandwidths ends one and begins the next.

    Args:
        record: with any rate and jitter.
        bandwidths: of the filters.
        reference: position set-points at the record's samples, shape (m, n).
        torque_lead: by how much a torque acted before its stamp, s. Viscous friction makes a torque that is late by d
            look like a rotor inertia that is too small by c2 d.

    Raises:
        IdentificationError: for bandwidths that the sampling rate does not carry, and if no piece is longer than the
            edges of the filters.
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
    # From 0 on: stamps of the wall clock are rounded to 0.2 us, which second derivatives at 5 kHz do not bear.
    count = np.arange(len(even)) / rate

    def smoothed(values: Array) -> Array:
        resampled = _resampled(*_bridged(time, values[piece]), even, 5)
        return np.asarray(sosfiltfilt(sections, resampled, axis=0, padlen=min(3 * edge, len(even) - 1)))

    position, order = smoothed(record.position), int(not bandwidths.recorded_velocity)
    curve = make_interp_spline(count, position if order else smoothed(record.velocity), k=5)
    at_torque, ours = None, np.full(len(time), fill_value=True)
    for begin, end in record.shocks:
        ours &= (time < begin) | (time > end)
    stamps, torque = time[ours] - torque_lead, record.torque[piece][ours]
    if not _is_even(stamps, even):
        samples = even[inner]
        first, last = np.searchsorted(stamps, samples[0], "right") - 1, np.searchsorted(stamps, samples[-1]) + 1
        around = stamps[max(int(first), 0) : last]
        resampling = BSpline.design_matrix(samples, np.pad(around, 1, "edge"), 1, extrapolate=True)
        at_torque = TorqueStamps(np.asarray(curve(around - even[0], order)), resampling)
    return FilteredRun(
        source=record.bag,
        names=record.names,
        time=even[inner],
        position=position[inner],
        velocity=np.asarray(curve(count[inner], order)),
        acceleration=np.asarray(curve(count[inner], order + 1)),
        torque=_resampled(stamps, torque, even, 1)[inner],
        reference=None if reference is None else _resampled(*_bridged(time, reference[piece]), even, 5)[inner],
        bandwidths=bandwidths,
        stamps=at_torque,
        shocks=record.shocks,
    )


def _rate(time: Array) -> float:
    """Return samples per second; a gap does not count."""
    if len(time) < 2:
        raise IdentificationError(f"a run of {len(time)} samples; accepted: a second of motion or more")
    steps = np.diff(time)
    usual = steps[steps < _GAP_PERIODS * np.median(steps)]
    return float(len(usual) / usual.sum())


def gaps(time: Array) -> Index:
    """Return the samples before which stamps have a gap of more than 3.5 periods."""
    steps = np.diff(time)
    return np.flatnonzero(steps > _GAP_PERIODS * np.median(steps)) + 1 if len(steps) else np.empty(0, dtype=np.intp)


def bridged_gap(bandwidths: Bandwidths) -> float:
    """Return how long a gap may be to be bridged, s."""
    return _BRIDGED_PERIODS / bandwidths.position


def _pieces(time: Array, bridged: float = 0.0) -> list[tuple[int, int]]:
    """Return the first sample and the one after the last of each piece without a gap that is longer than `bridged`."""
    breaks = [k for k in gaps(time).tolist() if time[k] - time[k - 1] > bridged]
    return list(pairwise([0, *breaks, len(time)]))


def _bridged(time: Array, values: Array) -> tuple[Array, Array]:
    """Return stamps and values with those that gaps lack, by the cubics that fit best to what lies beside them.

    A spline through the samples alone would swing in a gap as their noise has it.
    """
    added: list[tuple[int, Array, Array]] = []
    for k in gaps(time).tolist():
        begin, end = time[k - 1], time[k]
        period = float(np.median(np.diff(time)))
        missing = np.linspace(begin, end, max(2, round((end - begin) / period)) + 1)[1:-1]
        reach = max(_LEAST_BESIDE_GAP, len(missing))
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
    """Return values at even times; those whose stamps are even stay as they are."""
    return values if _is_even(time, even) else np.asarray(make_interp_spline(time, values, k=degree)(even))


def _is_even(time: Array, even: Array) -> bool:
    """Return whether stamps are at even times, but for rounding."""
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
    """Return every down-th sample of the filtered values at which the filter has its whole length.

    Args:
        values: shape (m, ...).
        taps: shape (2 h + 1,); the first sample that is returned lies at index h.
        down: samples from one to the next.
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
        taps: by which samples are multiplied, shape (t,).
        down: samples from one result to the next.
        result: takes the sums, of which the first begins at sample 0, shape (k, c).
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


_SHOCK_RATE = 250.0  # samples per second that shocks are sought at, about: means of 4 ms
_SHOCK_WINDOW = 0.06  # s, of the running median: pulses of up to half of it stand out
_SHOCK_OVER_SCATTER = 6.0  # least size over the 97.5th percentile of the scatter
_SHOCK_OVER_RANGE, _REVERSING_SHOCK_OVER_RANGE = 0.1, 0.5  # and over the torque's range; where a joint reverses
_SHOCK_MARGIN = 5e-3  # s, left out on both sides with it
_LOW_RATE = 67.0  # samples per second, of the slowest recordings that intervals are proven for
SLOW_SPEED, SLOW_SHARE = 0.05, 0.1
"""Below, an element is near a reversal or at rest: rad/s, or a share of the speed exceeded in a tenth of the run.

On real arms, rows below it pull Coulomb friction 10 to 25 % low.
"""


def without_shocks(record: JointRecord, elements: Array) -> tuple[JointRecord, tuple[str, ...]]:
    """Return a record with the times of its shocks, and in words what was found.

    Args:
        record: of n joints.
        elements: E, joint velocities to those of the friction elements, shape (n_el, n).
    """
    rate = (len(record.time) - 1) / max(float(record.time[-1] - record.time[0]), 1e-9)
    size = max(1, round(rate / _SHOCK_RATE))
    count = len(record.time) // size
    width = round(_SHOCK_WINDOW * rate / size) // 2 * 2 + 1
    if width < 5 or count <= width:  # a pulse would be one sample or none
        return record, ()
    time, velocity, torque = (
        values[: count * size].reshape(count, size, -1).mean(axis=1)
        for values in (record.time, record.velocity, record.torque)
    )
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
    texts, half = [], 0.5 * size / rate
    for start, stop in stretches(np.asarray(far.any(axis=1))):
        joint = int(np.argmax(np.where(far[start:stop], distance[start:stop], 0.0).max(axis=0)))
        begin, end = float(time[start, 0]) - half - _SHOCK_MARGIN, float(time[stop - 1, 0]) + half + _SHOCK_MARGIN
        if found and begin <= found[-1][1]:
            found[-1] = (found[-1][0], end)
            continue
        found.append((begin, end))
        height = float(distance[start:stop, joint].max())
        texts.append(f"{height:.3g} Nm at {record.names[joint]} {begin - float(record.time[0]):.3g} s after the begin")
    if not found:
        return record, ()
    lost = 1e3 * sum(end - begin for begin, end in found)
    shown = ", ".join(texts[:6]) + (", ..." if len(texts) > 6 else "")
    what = f"{len(found)} shock{'s' * (len(found) > 1)}"
    text = f"{record.source.name}: {what} of the torque left out, {lost:.0f} ms with margins: {shown}"
    return replace(record, shocks=tuple(found)), (text,)


def stretches(there: Mask) -> list[tuple[int, int]]:
    """Return where each stretch of samples begins and ends, the end excluded, of a condition, shape (m,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _near_rest(velocity: Array, width: int) -> Mask:
    """Return where elements are slow or reverse within a window of so many samples, shape (m, n_el)."""
    least = np.minimum(SLOW_SPEED, SLOW_SHARE * np.quantile(np.abs(velocity), 0.9, axis=0))
    turns = np.sign(minimum_filter1d(velocity, width, axis=0)) != np.sign(maximum_filter1d(velocity, width, axis=0))
    return np.asarray(maximum_filter1d((np.abs(velocity) < least) | turns, width, axis=0))


def recording_notes(records: Sequence[JointRecord], bandwidths: Bandwidths) -> tuple[str, ...]:
    """Return, in words, which gaps are bridged or split runs, that torques were smoothed, and which rates are low."""
    found, longest = [], bridged_gap(bandwidths)
    for record in records:
        steps = np.array([record.time[k] - record.time[k - 1] for k in gaps(record.time).tolist()])
        short, name = steps[steps <= longest], record.source.name
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
                f"warning: {name}: {rate:.3g} samples per second do not tell motion above {0.3 * rate:.3g} Hz, nor "
                f"what is over within {1e3 * 2.0 / rate:.0f} ms of a reversal, as bristles (c0, c1) and narrow "
                f"Stribeck rises; deviations are proven from {_LOW_RATE:g} samples per second on"
            )
    if (edge := smoothed_above(records)) is not None:
        found.append(
            f"the torques were smoothed before they were recorded, from about {edge:.2g} Hz on: what reversals and "
            "faster motion tell is lost, and their noise, which chi^2 compares with, is unknown"
        )
    return tuple(found)
