"""Rows of micro-oscillations: what small reversals of a record say about the bristles of the elements.

LuGre's bristles are deflected along each measured motion, and torques are compared at the frequencies of
micro-oscillations alone. In this band the noise of the encoder, which reaches the torque through the controller, is
some thousandths of the motion. The noise of the torque is in the measured side only, so it makes the estimates
uncertain, not biased; a simulation driven by the recorded torque would answer to its noise at the resonance.

The rows are real and imaginary parts of a motion's spectrum, joint by joint. Nuisance parameters are errors of the mass
matrix, and how far each bristle was deflected at the start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import butter, sosfiltfilt
from scipy.signal.windows import tukey

from rx90_common.base.arrays import Array, Mask, interpolated
from rx90_common.base.errors import IdentificationError
from rx90_common.estimation.fit import Problem
from rx90_common.estimation.law import deflect
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.arm import JointGroup, RigidArm
from rx90_emulator.identification.records import JointRecord, block_means, spikes, stretches

LOWEST_RATE = 500.0
"""Samples per second below which the damping of the bristles is not separable from a delay."""
INERTIA_SD = 0.05
"""Prior standard deviation of the errors of the mass matrix, in units of sqrt(M_jj M_ii)."""
# prior standard deviation of a start deflection, in units of that of steady sliding
_START_SD = 0.3
_BLOCK = 8  # steps in a block mean
_BAND_HZ = (2.0, 50.0)  # compared band: below are creep and weight, above is noise
_DETECTION_HZ = (2.0, 60.0)
_TAPER_SHARE = 0.2  # of a motion under the window's cosine flanks, against leakage
_SPAN_S = 0.5  # over which excursions and oscillations are measured
_MAX_EXCURSION = 4e-3  # rad within a span; beyond it the bristles slide, and drift dominates
_MIN_OSCILLATION = 5e-6  # rad, RMS; smaller ones are below the resolution of usual encoders
_MIN_MOTION_S = 0.8
_MAX_MOTION_S = 10.0
# least ratio to the torque of the other joints' accelerations: more than a reaction
_MIN_OWN_TORQUE = 2.0
# least step of the simulation: torques that were recorded faster are averaged over it
_MIN_STEP_S = 0.00025
_LOW_PASS_HZ = 200.0  # above which positions contain little but the encoder's noise
_MAX_GAP_S = 3e-3  # longest gap that is interpolated or, if longer,
_MAX_GAP_SAMPLES = 2.5
_TRANSIENT_S = 0.01  # on both sides of a gap that its transient reaches through the low-pass
# over which spikes are compared with the range: in a small motion small spikes show
_SPIKE_BLOCK_S = 1.0
_DIFFERENCE = 1e-4  # of the parameters, for difference quotients
_DISTANCES = (3e-5, 1e-4, 3e-4, 1e-3)  # rad of presliding, tau_c / c0, that a search begins with
_DAMPING_S = 1e-3  # s, c1 / c0 that it begins with


def band_spectrum(torque: Array, step: float) -> tuple[Array, Array]:
    """Return Fourier coefficients in the band of micro-oscillations (Tukey window), and their frequencies.

    Args:
        torque: block means, shape (b, k).
        step: of the samples, s.

    Returns:
        Real parts above imaginary parts, shape (r, k), scaled so that white noise keeps the standard deviation that
        it has in a single step; frequencies, Hz, shape (r,).
    """
    window, frequency, band = _window(len(torque), step)
    parts = rfft((torque - torque.mean(axis=0))[: len(window)] * window[:, None], axis=0)[band]
    parts = parts * np.sqrt(2.0 * _BLOCK / (window @ window))
    return np.concatenate([parts.real, parts.imag]), np.tile(frequency[band], 2)


@lru_cache(maxsize=16)
def _window(longest: int, step: float) -> tuple[Array, Array, Mask]:
    """Return a window over block means, the frequencies of its transform, Hz, and which of them are in the band.

    Its length is the largest one up to `longest` whose transform is fast (scipy.fft.prev_fast_len from SciPy 1.14 on).
    """
    length = next(n for n in range(longest, 0, -1) if next_fast_len(n, real=True) == n)
    frequency = rfftfreq(length, _BLOCK * step)
    return (
        tukey(length, _TAPER_SHARE),
        frequency,
        (frequency >= _BAND_HZ[0]) & (frequency <= _BAND_HZ[1]),
    )


@dataclass(frozen=True, eq=False)
class MicroMotion:
    """One micro-oscillation of the k joints of a group, b block means.

    Attributes:
        record: that contains it.
        interval: of the record's time, s.
        step: s.
        speed: of the joints, mean over each step, rad/s, shape (m, k).
        friction: drive torque less that of the rigid arm, Nm, shape (b, k).
        acceleration: of all n joints, rad/s^2, shape (b, n).
        mass: the group's rows of the mass matrix, kg m^2, shape (k, n).
        joints: the group's.
    """

    record: JointRecord
    interval: tuple[float, float]
    step: float
    speed: Array
    friction: Array
    acceleration: Array
    mass: Array
    joints: tuple[int, ...]

    @property
    def driven(self) -> float:
        """Return the least ratio, over the joints, of the RMS torque to that of the other joints' accelerations."""
        others = np.delete(np.arange(self.mass.shape[1]), self.joints)
        reaction = np.std(self.acceleration[:, others] @ self.mass[:, others].T, axis=0)
        inertia = self.acceleration[:, self.joints] @ self.mass[:, self.joints].T
        return float((np.std(self.friction + inertia, axis=0) / np.maximum(reaction, 1e-12)).min())

    @property
    def inertial(self) -> Array:
        """Return the torques of errors of the mass matrix, one for each pair of joints, Nm, shape (b, k, pairs)."""
        acceleration = self.acceleration[:, self.joints]
        inertia = np.diag(self.mass[:, self.joints])
        first, second = np.triu_indices(len(inertia))
        pairs = np.arange(len(first))
        torque = np.zeros((*acceleration.shape, len(first)))
        scale = np.sqrt(inertia[first] * inertia[second])
        torque[:, first, pairs] = scale * acceleration[:, second]
        torque[:, second, pairs] = scale * acceleration[:, first]
        return torque

    def load(self, break_away: Array) -> float:
        """Return the largest ratio, over the joints, of the friction's amplitude to break-away, Nm, shape (k,)."""
        return float(np.max(amplitudes(self.friction) / break_away))


def amplitudes(torque: Array) -> Array:
    """Return half of the span of each column without its outliers, shape (k,), for an array of shape (m, k)."""
    return np.asarray(0.5 * np.ptp(np.percentile(torque, (1.0, 99.0), axis=0), axis=0))


def find_micro_motions(
    record: JointRecord, arm: RigidArm, groups: Sequence[JointGroup]
) -> list[list[MicroMotion]]:
    """Return the micro-oscillations of each group of joints that its own motors make, or an empty list.

    Args:
        record: a bag's record; the torque of a sample acted until its stamp.
        arm: for weight and mass matrix; its joints are the record's.
        groups: of joints that share friction elements.
    """
    step, time, position, torque, known = _on_grid(record)
    # Central differences of fourth order; those of second order are 0.5 % low at 40 Hz and 0.5 ms.
    velocity = np.gradient(position, step, axis=0)
    near = position[3:-1] - position[1:-3]
    far = position[4:] - position[:-4]
    velocity[2:-2] = (8.0 * near - far) / (12.0 * step)
    active = _active(position, step) & known[:, None]
    unit = np.eye(len(arm.names))
    motions: list[list[MicroMotion]] = []
    for group in groups:
        joints = list(group.joints)
        motions.append([])
        for first, last in stretches(np.asarray(active[:, joints].any(axis=1))):
            if last - first < round(_MIN_MOTION_S / step):
                continue
            part = slice(first, min(last, first + round(_MAX_MOTION_S / step)))
            speed = np.diff(position[part], axis=0) / step
            place = block_means(position[part][1:], _BLOCK)
            acceleration = block_means(np.diff(velocity[part], axis=0) / step, _BLOCK)
            rigid = arm.torque(place, block_means(speed, _BLOCK), acceleration)
            pose = np.repeat(place.mean(axis=0)[None], len(unit), axis=0)
            mass = arm.torque(pose, 0.0 * unit, unit) - arm.torque(pose, 0.0 * unit, 0.0 * unit)
            motions[-1].append(
                MicroMotion(
                    record=record,
                    interval=(float(time[part][0]), float(time[part][-1])),
                    step=step,
                    speed=speed[:, joints],
                    friction=(block_means(torque[part][1:], _BLOCK) - rigid)[:, joints],
                    acceleration=acceleration,
                    mass=mass[joints],
                    joints=group.joints,
                )
            )
    everything = [motion for of_group in motions for motion in of_group]
    return [[motion for motion in of_group if _driven(motion, everything)] for of_group in motions]


def _driven(motion: MicroMotion, others: Sequence[MicroMotion]) -> bool:
    """Return whether the joints of a motion are moved by their motors, and not by the reactions of other joints."""
    begin, end = motion.interval
    together = [
        near.driven for near in others if near.interval[0] < end and begin < near.interval[1]
    ]
    return motion.driven >= min(_MIN_OWN_TORQUE, max(together))


@dataclass(frozen=True, eq=False)
class BristleRows:
    """Rows of M motions of one group, and its e elements as a function of their bristles.

    Parameters x are ln c0 and ln c1, element by element, then the start deflections, in units of those of steady
    sliding, motion by motion. All motions have about one pose, so that errors of the mass matrix are constant.

    Attributes:
        motions: M of them.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        elements: their sliding regime; c0 and c1 are not used.
    """

    motions: Sequence[MicroMotion]
    inputs: Array
    elements: Sequence[FrictionElement]

    @property
    def bristles(self) -> slice:
        """Return the place of ln c0 and ln c1."""
        return slice(0, 2 * len(self.elements))

    def problem(self) -> Problem:
        """Return the problem of x, with the errors of the mass matrix as linear parameters."""
        targets = []
        columns = []
        lines = []
        for number, motion in enumerate(self.motions):
            both = np.concatenate([motion.friction[:, :, None], motion.inertial], axis=2)
            spectrum, frequency = band_spectrum(both.reshape(len(both), -1), motion.step)
            spectrum = spectrum.reshape(-1, both.shape[2])
            targets.append(spectrum[:, 0])
            columns.append(spectrum[:, 1:])
            line = np.repeat(np.round(frequency), len(self.inputs[0]))
            lines.append(np.column_stack([np.full(len(line), number), line]))
        target = np.concatenate(targets)
        starts = len(self.motions) * len(self.elements)
        count = self.bristles.stop
        widest = np.concatenate([np.full(count, 25.0), np.full(starts, 5.0)])
        return Problem(
            target=target,
            linear=np.concatenate(columns),
            model=self.torque,
            start=np.zeros(count + starts),
            lower=-widest,
            upper=widest,
            group=np.tile(np.arange(len(self.inputs[0])), len(target) // len(self.inputs[0])),
            block=np.unique(np.concatenate(lines), axis=0, return_inverse=True)[1].ravel(),
            prior=np.eye(columns[0].shape[1]) / INERTIA_SD,
            spread=np.concatenate([np.full(count, np.inf), np.full(starts, _START_SD)]),
        )

    def starts(self) -> list[Array]:
        """Return values of x that a search may begin with."""
        coulomb = np.array([element.tau_c.positive for element in self.elements])
        free = np.zeros(len(self.motions) * len(self.elements))
        stiffness = [coulomb / distance for distance in _DISTANCES]
        return [
            np.append(np.log(np.column_stack([c0, _DAMPING_S * c0])).ravel(), free)
            for c0 in stiffness
        ]

    def torque(self, x: Array) -> tuple[Array, Array]:
        """Return the elements' spectra at the joints, in the order of the rows, and their derivatives by x."""
        values = np.exp(x[self.bristles]).reshape(-1, 2)
        starts = x[self.bristles.stop :].reshape(len(self.motions), -1)
        torques = []
        derivatives = []
        for number, traces in enumerate(self._traces):
            torque = np.zeros((len(traces[0].viscous_spectrum), len(self.inputs[0])))
            slopes = np.zeros((*torque.shape, len(x)))
            for n, (trace, (c0, c1), start) in enumerate(
                zip(traces, values, starts[number], strict=True)
            ):
                here = trace.spectrum(c0, start)
                stiffer = (
                    (trace.spectrum(c0 * (1.0 + _DIFFERENCE), start) - here)
                    @ (1.0, c1)
                    / _DIFFERENCE
                )
                deflected = (
                    (trace.spectrum(c0, start + _DIFFERENCE) - here) @ (1.0, c1) / _DIFFERENCE
                )
                torque += np.outer(here @ (1.0, c1) + trace.viscous_spectrum, self.inputs[n])
                slopes[:, :, 2 * n] = np.outer(stiffer, self.inputs[n])
                slopes[:, :, 2 * n + 1] = np.outer(c1 * here[:, 1], self.inputs[n])
                slopes[:, :, self.bristles.stop + number * len(traces) + n] = np.outer(
                    deflected, self.inputs[n]
                )
            torques.append(torque.ravel())
            derivatives.append(slopes.reshape(-1, len(x)))
        return np.concatenate(torques), np.concatenate(derivatives)

    def deflection_torque(self, x: Array, number: int) -> Array:
        """Return block means of the bristles' c0 z along a motion, Nm, shape (b, e)."""
        values = np.exp(x[self.bristles]).reshape(-1, 2)
        starts = x[self.bristles.stop :].reshape(len(self.motions), -1)[number]
        traces = zip(self._traces[number], values, starts, strict=True)
        return np.column_stack(
            [trace.bristles(c0, start)[:, 0] for trace, (c0, _), start in traces]
        )

    @cached_property
    def _traces(self) -> list[list[_Trace]]:
        return [
            [
                _Trace(element, motion.speed @ share, motion.step)
                for element, share in zip(self.elements, self.inputs, strict=True)
            ]
            for motion in self.motions
        ]


@dataclass(frozen=True, eq=False)
class _Trace:
    """The motion of one element, at speeds that are constant in each step, rad/s, shape (m,)."""

    element: FrictionElement
    speed: Array
    step: float

    @cached_property
    def viscous_spectrum(self) -> Array:
        viscous = block_means(self.element.viscous_torque(self.speed), _BLOCK)
        return band_spectrum(viscous[:, None], self.step)[0][:, 0]

    @cached_property
    def spectrum(self) -> Callable[[float, float], Array]:
        """Return a function for the spectra of `bristles`, (r, 2); difference quotients ask for the same ones again."""
        return lru_cache(16)(
            lambda c0, start: band_spectrum(self.bristles(c0, start), self.step)[0]
        )

    @cached_property
    def _sliding_torque(self) -> Array:
        return self.element.sliding_torque(self.speed)

    def bristles(self, c0: float, start: float) -> Array:
        """Return block means of the bristles' torque, Nm, and of the rate that c1 multiplies, rad/s, shape (b, 2)."""
        result = np.empty((len(self.speed), 2))
        first = start * self.element.tau_c.positive / c0
        deflect(self.speed, self._sliding_torque, self.step, c0, first, result)
        return block_means(result, _BLOCK)


def _on_grid(record: JointRecord) -> tuple[float, Array, Array, Array, Mask]:
    """Return step, times, positions and torques on equal steps, and which are not affected by a gap."""
    step = record.period or np.inf
    if 1.0 / step < LOWEST_RATE:
        raise IdentificationError(
            f"{record.source}: {1.0 / step:.4g} samples per second; accepted: {LOWEST_RATE:g} or more for the "
            "presliding regime, such as motor_states"
        )
    size = max(1, round(_SPIKE_BLOCK_S / step))
    values = np.hstack([record.position, record.torque])
    rows = ~np.concatenate(
        [spikes(values[first : first + size]) for first in range(0, len(values), size)]
    )
    there = record.time[rows]
    time = there[0] + step * np.arange(round((there[-1] - there[0]) / step) + 1)
    known = np.ones(len(time), dtype=np.bool_)
    for k in np.flatnonzero(np.diff(there) > max(_MAX_GAP_S, _MAX_GAP_SAMPLES * step)):
        known[
            slice(*np.searchsorted(time, (there[k] - _TRANSIENT_S, there[k + 1] + _TRANSIENT_S)))
        ] = False
    # Set-points are constant between updates, which makes images of an oscillation near multiples of their rate;
    # without the low-pass, coarser steps would alias them onto it.
    sections = butter(4, min(_LOW_PASS_HZ, 0.4 / step), fs=1.0 / step, output="sos")
    even = interpolated(time, there, values[rows])
    position, torque = np.hsplit(sosfiltfilt(sections, even, axis=0), 2)
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
    return quiet & (power > _MIN_OSCILLATION**2) & (power > drift)
