"""Find the micro-oscillations of a record, prepare them for a fit, and compare torques in their frequency band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import butter, sosfiltfilt
from scipy.signal.windows import tukey

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord, spikes

BLOCK = 8
"""Steps of the simulation in one block mean."""
_BAND_LOW_HZ, _BAND_HIGH_HZ = 2.0, 50.0  # Hz: slower is creep and weight, faster is noise
_TAPER_SHARE = 0.2  # share of a motion under the window's cosine flanks, against leakage


def block_means(values: Array) -> Array:
    """Return means of BLOCK rows; white noise stays white, and micro-oscillations are slower.

    Args:
        values: shape (m, ...).

    Returns:
        Shape (m // BLOCK, ...).
    """
    length = len(values) // BLOCK * BLOCK
    return np.asarray(values[:length].reshape(-1, BLOCK, *values.shape[1:]).mean(axis=1))


def fast_length(longest: int) -> int:
    """Return the largest length up to `longest` >= 1 whose real Fourier transform is fast: 2^i 3^j 5^k.

    scipy.fft.prev_fast_len(longest, real=True) is the same, from SciPy 1.14 on.
    """
    odd: list[int] = [3**j * 5**k for j in range(longest.bit_length()) for k in range(longest.bit_length())]
    return max(n << (longest // n).bit_length() - 1 for n in odd if n <= longest)


@lru_cache(maxsize=16)
def _window(length: int, step: float) -> tuple[Array, Array, Mask]:
    """Return the window over block means, the frequencies of its transform, Hz, and which are in the band."""
    frequency = rfftfreq(length, BLOCK * step)
    return tukey(length, _TAPER_SHARE), frequency, (frequency >= _BAND_LOW_HZ) & (frequency <= _BAND_HIGH_HZ)


def band_spectrum(torque: Array, step: float) -> tuple[Array, Array]:
    """Return Fourier coefficients in the band of micro-oscillations (Tukey window), and their frequencies.

    Args:
        torque: block means, shape (b, k).
        step: of the simulation, s.

    Returns:
        Real parts above imaginary parts, shape (r, k), scaled so that white noise keeps the standard deviation that
        it has in a single step; frequencies, Hz, shape (r,).
    """
    length = fast_length(len(torque))
    window, frequency, band = _window(length, step)
    parts = rfft((torque - torque.mean(axis=0))[:length] * window[:, None], axis=0)[band]
    parts = parts * np.sqrt(2.0 * BLOCK / (window @ window))
    return np.concatenate([parts.real, parts.imag]), np.tile(frequency[band], 2)


LOWEST_RATE = 500.0
"""Samples per second below which the damping of the bristles is not separable from a delay."""
_SPAN_S = 0.5  # s, over which excursions and oscillations are measured
_MAX_EXCURSION = 4e-3  # rad within a span; beyond it the bristles slide, and drift takes over
_MIN_OSCILLATION = 5e-6  # rad, RMS; smaller ones are below the resolution of usual encoders
_MIN_MOTION_S, _MAX_MOTION_S = 0.8, 10.0  # s
_BREAK_AWAY_SHARE = 0.7  # beyond it bristles slide, and their torque depends little on c0 and c1
_MIN_RELATIVE_LOAD = 0.25  # of the strongest motion of a group
_MIN_OWN_TORQUE = 2.0  # times the torque of the other joints' accelerations: so much is no mere reaction
_MAX_MOTIONS_PER_BAG = 3  # motions of a group in a bag
_MIN_STEP_S = 0.00025  # s, step of the simulation: recorded faster, torques are averaged over it
_DETECTION_LOW_HZ, _DETECTION_HIGH_HZ = 2.0, 60.0  # Hz, the band of micro-oscillations
_LOW_PASS_HZ = 200.0  # Hz, above which positions hold little but the encoder's noise
_MAX_GAP_S = 3e-3  # s without a message, beyond which the motion is not interpolated
_MAX_GAP_SAMPLES = 2.5  # sample periods, where these are longer
_TRANSIENT_S = 0.01  # s beside a gap that its transient reaches through the low-pass
_SPIKE_BLOCK_S = 1.0  # s, over which spikes are compared with the signal's range


@dataclass(frozen=True, eq=False)
class MicroMotion:
    """One micro-oscillation, for the k joints of a group.

    Attributes:
        joints: indices of the group's joints, k of them.
        step: sample period, s.
        position: low-passed, at the end of each step, rad, shape (m, k).
        velocity: mean over each step, rad/s, shape (m, k).
        acceleration: the same of all n joints, rad/s^2, shape (m, n).
        drive: drive torque less weight, held over each step, Nm, shape (m, k).
        mass: the group's rows of the mass matrix, kg m^2, shape (k, n).
        inertia: its diagonal, kg m^2, shape (n,).
        record: the bag's record.
        interval: s, of the record's time.
        driven: whether the joints are moved by their motors, and not only by the reactions of other joints.
    """

    joints: tuple[int, ...]
    step: float
    position: Array
    velocity: Array
    acceleration: Array
    drive: Array
    mass: Array
    inertia: Array
    record: JointRecord
    interval: tuple[float, float]
    driven: bool = True

    @property
    def own(self) -> float:
        """Return torque over that of the other joints' accelerations, RMS, of the joint where this is least."""
        others = np.delete(np.arange(self.mass.shape[1]), self.joints)
        reaction = self.acceleration[:, others] @ self.mass[:, others].T
        return float((np.std(self.drive - reaction, axis=0) / np.maximum(np.std(reaction, axis=0), 1e-12)).min())


@dataclass(frozen=True, eq=False)
class _Grid:
    """A record on equal steps."""

    step: float
    time: Array
    position: Array
    torque: Array
    known: Mask


def find_micro_motions(
    record: JointRecord, arm: RigidArm, groups: Sequence[Sequence[int]], torque_delay: float = 0.0
) -> list[MicroMotion]:
    """Return the micro-oscillations of each group of joints.

    Args:
        record: a bag's record; the torque of a sample is what acted until its stamp.
        arm: for weight and mass matrix; its joints are the record's.
        groups: indices of joints that share friction elements.
        torque_delay: how much later than recorded the torque acted, s.

    Raises:
        IdentificationError: if the record is too slow.
    """
    grid = _on_grid(record, torque_delay)
    velocity = _derivative(grid.position, grid.step)
    active = _active(grid) & grid.known[:, None]
    found = []
    for group in groups:
        for first, last in _runs(np.asarray(active[:, list(group)].any(axis=1)), round(_MIN_MOTION_S / grid.step)):
            end = min(last, first + round(_MAX_MOTION_S / grid.step))
            found.append(_motion(record, arm, tuple(group), grid, (grid.position, velocity), first, end))
    return [replace(motion, driven=motion.own >= min(_MIN_OWN_TORQUE, _most_own(motion, found))) for motion in found]


def _most_own(motion: MicroMotion, found: Sequence[MicroMotion]) -> float:
    """Return how much of their own the joints have that have most at the same time."""
    begin, end = motion.interval
    return max(other.own for other in found if other.interval[0] < end and begin < other.interval[1])


def most_informative(motions: Sequence[MicroMotion], break_away: Array) -> list[MicroMotion]:
    """Return the motions with the largest friction torques short of break-away, at most three of each bag.

    Args:
        motions: of one group of k joints.
        break_away: friction torque at which each joint slides, Nm, shape (k,).
    """
    loads = [load_of(motion, break_away) for motion in motions]
    below = [load for load in loads if load <= _BREAK_AWAY_SHARE]
    # Faint motions are reactions to other joints'; where all motions break away, the smallest one is best.
    faintest = _MIN_RELATIVE_LOAD * max(below) if below else 0.0
    limit = _BREAK_AWAY_SHARE if below else 1.5 * min(loads)
    chosen: dict[tuple[str, str], list[MicroMotion]] = {}
    for load, motion in sorted(zip(loads, motions, strict=True), key=lambda pair: -pair[0]):
        bag = chosen.setdefault((motion.record.sha256, str(motion.record.source)), [])
        if faintest <= load <= limit and len(bag) < _MAX_MOTIONS_PER_BAG:
            bag.append(motion)
    return [motion for bag in chosen.values() for motion in bag]


def load_of(motion: MicroMotion, break_away: Array) -> float:
    """Return the amplitude of the friction torque over the torque of break-away, of the joint that has most."""
    low_pass = butter(2, _DETECTION_HIGH_HZ, fs=1.0 / motion.step, output="sos")
    friction = sosfiltfilt(low_pass, motion.drive - motion.acceleration @ motion.mass.T, axis=0)
    low, high = np.percentile(friction, (1.0, 99.0), axis=0)
    return float(np.max(0.5 * (high - low) / break_away))


def _on_grid(record: JointRecord, torque_delay: float) -> _Grid:
    step = float(np.median(np.diff(record.time))) if len(record.time) > 1 else np.inf
    if 1.0 / step < LOWEST_RATE:
        raise IdentificationError(
            f"{record.source}: {1.0 / step:.4g} samples per second; accepted: {LOWEST_RATE:g} or more for the "
            "presliding regime, such as motor_states"
        )
    rows = _without_spikes(record, step)
    taken = record.time[rows]
    time = taken[0] + step * np.arange(round((taken[-1] - taken[0]) / step) + 1)
    position = np.column_stack([np.interp(time, taken, column) for column in record.position[rows].T])
    torque = np.column_stack([np.interp(time - torque_delay, taken, column) for column in record.torque[rows].T])
    known = _known(taken, time, step)
    # Set-points are held, which leaves images of an oscillation beside multiples of their rate; without the low-pass,
    # coarser steps would alias them onto it.
    return _coarser(_Grid(step, time, _low_passed(position, step), _low_passed(torque, step), known))


def _without_spikes(record: JointRecord, step: float) -> NDArray[np.intp]:
    """Return the samples without a spike, second by second: the range of a small motion shows smaller ones."""
    size, values = max(1, round(_SPIKE_BLOCK_S / step)), np.hstack([record.position, record.torque])
    found = [spikes(values[first : first + size]) for first in range(0, len(record.time), size)]
    return np.flatnonzero(~np.concatenate(found))


def _known(taken: Array, time: Array, step: float) -> Mask:
    """Return which times lie neither in a gap between the samples taken nor beside one, shape of `time`."""
    known = np.ones(len(time), dtype=np.bool_)
    for k in np.flatnonzero(np.diff(taken) > max(_MAX_GAP_S, _MAX_GAP_SAMPLES * step)):
        known[slice(*np.searchsorted(time, (taken[k] - _TRANSIENT_S, taken[k + 1] + _TRANSIENT_S)))] = False
    return known


def _low_passed(values: Array, step: float) -> Array:
    sections = butter(4, min(_LOW_PASS_HZ, 0.4 / step), fs=1.0 / step, output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=0))


def _derivative(values: Array, step: float) -> Array:
    """Return central differences of fourth order; of second order they are 0.5 % low at 40 Hz and 0.5 ms."""
    found = np.gradient(values, step, axis=0)
    found[2:-2] = (8.0 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12.0 * step)
    return found


def _coarser(grid: _Grid) -> _Grid:
    """Average the torque over the simulation's steps; a torque acts until its stamp."""
    factor = max(1, int(_MIN_STEP_S / grid.step + 1e-6))
    count = (len(grid.time) - 1) // factor
    last = 1 + factor * count
    torque = grid.torque.copy()
    torque[factor:last:factor] = grid.torque[1:last].reshape(count, factor, -1).mean(axis=1)
    known = grid.known.copy()
    known[factor:last:factor] = grid.known[1:last].reshape(count, factor).all(axis=1)
    rows = slice(0, last, factor)
    return _Grid(grid.step * factor, grid.time[rows], grid.position[rows], torque[rows], known[rows])


def _active(grid: _Grid) -> Mask:
    """Return where each joint oscillates without going far, shape (m, n)."""
    span = max(3, round(_SPAN_S / grid.step))
    excursion = maximum_filter1d(grid.position, span, axis=0) - minimum_filter1d(grid.position, span, axis=0)
    band = butter(2, (_DETECTION_LOW_HZ, _DETECTION_HIGH_HZ), btype="band", fs=1.0 / grid.step, output="sos")
    centred = grid.position - grid.position.mean(axis=0)
    power = uniform_filter1d(sosfiltfilt(band, centred, axis=0) ** 2, span, axis=0)
    low = butter(2, _DETECTION_LOW_HZ, fs=1.0 / grid.step, output="sos")
    slow = sosfiltfilt(low, centred, axis=0)
    drift = uniform_filter1d((slow - uniform_filter1d(slow, span, axis=0)) ** 2, span, axis=0)
    quiet = (excursion < _MAX_EXCURSION).all(axis=1, keepdims=True)
    return np.asarray(quiet & (power > _MIN_OSCILLATION**2) & (power > drift))


def _runs(mask: Mask, shortest: int) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= shortest]


def _motion(
    record: JointRecord,
    arm: RigidArm,
    group: tuple[int, ...],
    grid: _Grid,
    smooth: tuple[Array, Array],
    first: int,
    last: int,
) -> MicroMotion:
    joints = list(group)
    pose = smooth[0][first:last].mean(axis=0)[None]
    nothing = np.zeros_like(pose)
    weight = arm.torque(pose, nothing, nothing)[0]
    unit = np.eye(len(record.names))
    mass = arm.torque(np.repeat(pose, len(unit), axis=0), np.zeros_like(unit), unit) - weight
    end = slice(first + 1, last)
    position = 0.5 * (smooth[0][first : last - 1] + smooth[0][end])
    velocity, acceleration = (np.diff(part[first:last], axis=0) / grid.step for part in smooth)
    drive = grid.torque[end][:, joints] - weight[joints]
    drive = drive - (position - pose) @ _stiffness(arm, pose)[joints].T
    return MicroMotion(
        joints=group,
        step=grid.step,
        position=np.ascontiguousarray(smooth[0][end][:, joints]),
        velocity=np.ascontiguousarray(velocity[:, joints]),
        acceleration=acceleration,
        drive=np.ascontiguousarray(drive),
        mass=mass[joints],
        inertia=np.diag(mass),
        record=record,
        interval=(float(grid.time[first]), float(grid.time[last - 1])),
    )


def _stiffness(arm: RigidArm, pose: Array) -> Array:
    """Return the derivative of the weight by the pose, Nm/rad, shape (n, n)."""
    small = 1e-4 * np.eye(pose.shape[1])
    nothing = np.zeros_like(small)
    ahead, behind = (arm.torque(pose + shift, nothing, nothing) for shift in (small, -small))
    return np.asarray((ahead - behind).T / 2e-4)
