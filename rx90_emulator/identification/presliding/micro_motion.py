"""Find the micro-oscillations of a record, prepare them for a fit, and compare torques in their frequency band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import butter, sosfiltfilt
from scipy.signal.windows import tukey

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord, block_means, spikes, stretches

BLOCK = 8
"""Steps of the simulation in one block mean."""
LOWEST_RATE = 500.0
"""Samples per second below which the damping of the bristles is not separable from a delay."""
_BAND_HZ = (2.0, 50.0)  # Hz, compared band: below are creep and weight, above is noise
_DETECTION_HZ = (2.0, 60.0)  # Hz, band in which micro-oscillations are detected
_TAPER_SHARE = 0.2  # share of a motion under the window's cosine flanks, against leakage
_SPAN_S = 0.5  # s, over which excursions and oscillations are measured
_MAX_EXCURSION = 4e-3  # rad within a span; beyond it the bristles slide, and drift dominates
_MIN_OSCILLATION = 5e-6  # rad, RMS; smaller ones are below the resolution of usual encoders
_MIN_MOTION_S = 0.8
_MAX_MOTION_S = 10.0
_BREAK_AWAY_SHARE = 0.7  # beyond it bristles slide, and their torque depends little on c0 and c1
_MIN_RELATIVE_LOAD = 0.25  # of the strongest motion of a group
_MIN_OWN_TORQUE = 2.0  # least ratio to the torque of the other joints' accelerations: more than a reaction
_MAX_MOTIONS_PER_BAG = 3  # of a group
_MIN_STEP_S = 0.00025  # s, least step of the simulation: torques that were recorded faster are averaged over it
_LOW_PASS_HZ = 200.0  # Hz, above which positions contain little but the encoder's noise
# longest gap that is interpolated: s or, if longer, sample periods
_MAX_GAP_S = 3e-3
_MAX_GAP_SAMPLES = 2.5
_TRANSIENT_S = 0.01  # s on both sides of a gap that its transient reaches through the low-pass
_SPIKE_BLOCK_S = 1.0  # s, over which spikes are compared with the range: in a small motion small spikes show
_POSE_STEP = 1e-4  # rad, of differences of the weight


@lru_cache(maxsize=16)
def _window(longest: int, step: float) -> tuple[Array, Array, Mask]:
    """Return a window over block means, the frequencies of its transform, Hz, and which of them are in the band.

    Its length is the largest one up to `longest` whose transform is fast (scipy.fft.prev_fast_len from SciPy 1.14 on).
    """
    length = next(n for n in range(longest, 0, -1) if next_fast_len(n, real=True) == n)
    frequency = rfftfreq(length, BLOCK * step)
    return tukey(length, _TAPER_SHARE), frequency, (frequency >= _BAND_HZ[0]) & (frequency <= _BAND_HZ[1])


def band_spectrum(torque: Array, step: float) -> tuple[Array, Array]:
    """Return Fourier coefficients in the band of micro-oscillations (Tukey window), and their frequencies.

    Args:
        torque: block means, shape (b, k).
        step: of the simulation, s.

    Returns:
        Real parts above imaginary parts, shape (r, k), scaled so that white noise keeps the standard deviation that
        it has in a single step; frequencies, Hz, shape (r,).
    """
    window, frequency, band = _window(len(torque), step)
    parts = rfft((torque - torque.mean(axis=0))[: len(window)] * window[:, None], axis=0)[band]
    parts = parts * np.sqrt(2.0 * BLOCK / (window @ window))
    return np.concatenate([parts.real, parts.imag]), np.tile(frequency[band], 2)


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
    record: JointRecord
    interval: tuple[float, float]
    driven: bool = True

    @property
    def own(self) -> float:
        """Return the least ratio, over the joints, of the RMS torque to that of the other joints' accelerations."""
        others = np.delete(np.arange(self.mass.shape[1]), self.joints)
        reaction = self.acceleration[:, others] @ self.mass[:, others].T
        return float((np.std(self.drive - reaction, axis=0) / np.maximum(np.std(reaction, axis=0), 1e-12)).min())

    @property
    def friction(self) -> Array:
        """Return the friction torque, drive less weight and inertia, Nm, shape (m, k)."""
        return np.asarray(self.drive - self.acceleration @ self.mass.T)

    @property
    def inertia_scale(self) -> Array:
        """Return sqrt(M_jj M_ii) of the group's joints, kg m^2, shape (k, k), the unit of errors of M."""
        inertia = np.diag(self.mass[:, list(self.joints)])
        return np.asarray(np.sqrt(np.outer(inertia, inertia)))

    def load(self, break_away: Array) -> float:
        """Return the largest ratio, over the joints, of the friction's amplitude to break-away, Nm, shape (k,)."""
        friction = sosfiltfilt(butter(2, _DETECTION_HZ[1], fs=1.0 / self.step, output="sos"), self.friction, axis=0)
        low, high = np.percentile(friction, (1.0, 99.0), axis=0)
        return float(np.max(0.5 * (high - low) / break_away))


def find_micro_motions(
    record: JointRecord, arm: RigidArm, groups: Sequence[Sequence[int]], torque_delay: float = 0.0
) -> list[MicroMotion]:
    """Return the micro-oscillations of each group of joints.

    Args:
        record: a bag's record; the torque of a sample acted until its stamp.
        arm: for weight and mass matrix; its joints are the record's.
        groups: indices of joints that share friction elements.
        torque_delay: how much later than recorded the torque acted, s.
    """
    step, time, position, torque, known = _on_grid(record, torque_delay)
    # Central differences of fourth order; those of second order are 0.5 % low at 40 Hz and 0.5 ms.
    velocity = np.gradient(position, step, axis=0)
    velocity[2:-2] = (8.0 * (position[3:-1] - position[1:-3]) - (position[4:] - position[:-4])) / (12.0 * step)
    active = _active(position, step) & known[:, None]
    unit = np.eye(len(arm.names))
    found = []
    for joints in map(list, groups):
        for first, last in stretches(np.asarray(active[:, joints].any(axis=1))):
            if last - first < round(_MIN_MOTION_S / step):
                continue
            part = slice(first, min(last, first + round(_MAX_MOTION_S / step)))
            pose = position[part].mean(axis=0)[None]
            weight = arm.torque(pose, 0.0 * pose, 0.0 * pose)[0]
            mass = arm.torque(np.repeat(pose, len(unit), axis=0), 0.0 * unit, unit) - weight
            ahead = arm.torque(pose + _POSE_STEP * unit, 0.0 * unit, 0.0 * unit)
            behind = arm.torque(pose + -_POSE_STEP * unit, 0.0 * unit, 0.0 * unit)
            stiffness = (ahead - behind).T / (2.0 * _POSE_STEP)  # of the weight, Nm/rad
            middle = 0.5 * (position[part][:-1] + position[part][1:])
            drive = torque[part][1:, joints] - weight[joints] - (middle - pose) @ stiffness[joints].T
            mean = np.diff(position[part], axis=0) / step
            acceleration = np.diff(velocity[part], axis=0) / step
            found.append(
                MicroMotion(
                    joints=tuple(joints),
                    step=step,
                    position=np.ascontiguousarray(position[part][1:, joints]),
                    velocity=np.ascontiguousarray(mean[:, joints]),
                    acceleration=acceleration,
                    drive=np.ascontiguousarray(drive),
                    mass=mass[joints],
                    record=record,
                    interval=(float(time[part][0]), float(time[part][-1])),
                )
            )
    driven = []
    for motion in found:
        begin, end = motion.interval
        together = (other.own for other in found if other.interval[0] < end and begin < other.interval[1])
        driven.append(motion.own >= min(_MIN_OWN_TORQUE, max(together)))
    return [replace(motion, driven=own) for motion, own in zip(found, driven, strict=True)]


def most_informative(motions: Sequence[MicroMotion], break_away: Array) -> list[MicroMotion]:
    """Return the motions with the largest friction torques short of break-away, at most three of each bag.

    Args:
        motions: of one group of k joints.
        break_away: friction torque at which each joint slides, Nm, shape (k,).
    """
    loads = [motion.load(break_away) for motion in motions]
    below = [load for load in loads if load <= _BREAK_AWAY_SHARE]
    # Faint motions are reactions to other joints; if all motions break away, the smallest one is best.
    faintest = _MIN_RELATIVE_LOAD * max(below) if below else 0.0
    limit = _BREAK_AWAY_SHARE if below else 1.5 * min(loads)
    chosen: dict[tuple[str, str], list[MicroMotion]] = {}
    for load, motion in sorted(zip(loads, motions, strict=True), key=lambda pair: -pair[0]):
        bag = chosen.setdefault((motion.record.sha256, str(motion.record.source)), [])
        if faintest <= load <= limit and len(bag) < _MAX_MOTIONS_PER_BAG:
            bag.append(motion)
    return [motion for bag in chosen.values() for motion in bag]


def _on_grid(record: JointRecord, torque_delay: float) -> tuple[float, Array, Array, Array, Mask]:
    """Return step, times, positions and torques on equal steps, and which are not affected by a gap."""
    step = record.period or np.inf
    if 1.0 / step < LOWEST_RATE:
        raise IdentificationError(
            f"{record.source}: {1.0 / step:.4g} samples per second; accepted: {LOWEST_RATE:g} or more for the "
            "presliding regime, such as motor_states"
        )
    size = max(1, round(_SPIKE_BLOCK_S / step))
    values = np.hstack([record.position, record.torque])
    rows = ~np.concatenate([spikes(values[first : first + size]) for first in range(0, len(values), size)])
    there = record.time[rows]
    time = there[0] + step * np.arange(round((there[-1] - there[0]) / step) + 1)
    known = np.ones(len(time), dtype=np.bool_)
    for k in np.flatnonzero(np.diff(there) > max(_MAX_GAP_S, _MAX_GAP_SAMPLES * step)):
        known[slice(*np.searchsorted(time, (there[k] - _TRANSIENT_S, there[k + 1] + _TRANSIENT_S)))] = False
    # Set-points are constant between updates, which makes images of an oscillation near multiples of their rate;
    # without the low-pass, coarser steps would alias them onto it.
    sections = butter(4, min(_LOW_PASS_HZ, 0.4 / step), fs=1.0 / step, output="sos")
    position = np.asarray(
        sosfiltfilt(sections, np.column_stack([np.interp(time, there, c) for c in record.position[rows].T]), axis=0)
    )
    torque = np.asarray(
        sosfiltfilt(
            sections, np.column_stack([np.interp(time - torque_delay, there, c) for c in record.torque[rows].T]), axis=0
        )
    )
    # The torque is averaged over the simulation's steps; it acts until its stamp.
    factor = max(1, int(_MIN_STEP_S / step + 1e-6))
    chosen = slice(0, 1 + (len(time) - 1) // factor * factor, factor)
    mean = np.concatenate([torque[:1], block_means(torque[1:], factor)])
    whole = np.append(known[0], block_means(known[1:], factor) == 1.0)
    return step * factor, time[chosen], position[chosen], mean, whole


def _active(position: Array, step: float) -> Mask:
    """Return where each joint oscillates with small excursions, shape (m, n)."""
    span = max(3, round(_SPAN_S / step))
    rate = 1.0 / step
    excursion = maximum_filter1d(position, span, axis=0) - minimum_filter1d(position, span, axis=0)
    band = butter(2, _DETECTION_HZ, btype="band", fs=rate, output="sos")
    centred = position - position.mean(axis=0)
    power = uniform_filter1d(sosfiltfilt(band, centred, axis=0) ** 2, span, axis=0)
    slow = sosfiltfilt(butter(2, _DETECTION_HZ[0], fs=rate, output="sos"), centred, axis=0)
    drift = uniform_filter1d((slow - uniform_filter1d(slow, span, axis=0)) ** 2, span, axis=0)
    quiet = (excursion < _MAX_EXCURSION).all(axis=1, keepdims=True)
    return np.asarray(quiet & (power > _MIN_OSCILLATION**2) & (power > drift))
