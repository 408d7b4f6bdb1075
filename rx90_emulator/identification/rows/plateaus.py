"""Find the plateaus of a record: stretches in which every joint keeps its velocity.

A joint keeps its velocity where the mean velocities before and after an instant agree. They are compared over times of
several lengths, the long ones only for slow motion, where ripple is slow and noise large. Of a plateau, the beginning
is left out, until servo loops and bristles have settled; one whose velocity bends, as at the crest of a wave, is left
out as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.records import BagSource, JointRecord, block_means, stretches

SETTLE_DISTANCE = 5e-3
"""Travel after which a bristle has its steady deflection, rad: ten times g or more for joints of this class."""
USED = "used"
CHANGES = "rest or changes of velocity"
SHORT = "settling or too short"
BENDS = "acceleration or a crest"
REASONS = (CHANGES, SHORT, BENDS, USED)
"""Use of a sample, or the reason why it was not used."""
_SCALES = ((0.4, 0.025), (0.1, 0.1), (0.02, np.inf))
"""Times over which velocities are compared, s, each with the largest speed for it, rad/s."""
_LEAST_SAMPLES = 3  # over which a velocity is a mean: single samples at 67 Hz are mostly noise
_SAME_VELOCITY = 0.02  # largest change within a plateau, as a share of its velocity, or
_REST_SHARE = 0.01  # of the fastest joint's velocity: moving joints shake those at rest
_NOISE_SD = 6.0  # standard deviations of the noise of a change that are no change
_MOST_NOISE = 0.75  # of the velocity, which keeps its sign
_NOISE_WINDOW_S = 2.0  # over which the noise is estimated, from
_NOISE_SAMPLES = 21
_MAD_TO_DEVIATION = 1.4826  # and that of a change over that of its second difference, for white noise of positions:
_CHANGE_SHARE = np.sqrt(6.0 / 70.0)
_SETTLE_S = 0.25  # for the servo loops after a change of velocity: their integrators' pole is near 20 /s
_SETTLE_SHARE = 0.5  # of a plateau, within which bristles must settle for the element to count as sliding
_TREND_BLOCKS = 8  # of a plateau, to which a parabola is fitted
_MAX_BEND = 0.02  # of the velocity, change of the parabola over the plateau, if
_BEND_SD = 3.0  # standard deviations of the blocks' scatter or more
_BLOCK_S = 0.25
_BLOCK_TRAVEL = 0.02  # rad: the rigid torque is nearly linear within it
_BLOCK_SAMPLES = 8
_LISTED_S = 0.05  # from which a reason is listed


@dataclass(frozen=True, eq=False)
class Plateau:
    """A settled stretch of constant velocity.

    Attributes:
        blocks: first and last sample (exclusive) of each block, shape (b, 2).
        sliding: which friction elements slide and do not stick, shape (n_el,).
    """

    blocks: Index
    sliding: Mask

    @property
    def rows(self) -> slice:
        """Return the plateau's samples."""
        return slice(int(self.blocks[0, 0]), int(self.blocks[-1, 1]))


@dataclass(frozen=True, eq=False)
class BagUse:
    """What was used of one bag of sweeps.

    Attributes:
        bag: the bag.
        stretches: number of plateaus.
        speeds: slowest and fastest speed of each element, rad/s, 0 if there is none, shape (n_el, 2).
        seconds: by use or reason why not.
    """

    bag: BagSource
    stretches: int
    speeds: Array
    seconds: Mapping[str, float]

    def text(self, names: Sequence[str]) -> str:
        """Return it as a line, with the elements by these names."""
        used = "NOTHING"
        if self.stretches:
            ranges = [
                f"{name} {low:.3g} to {high:.3g}"
                for name, (low, high) in zip(names, self.speeds.tolist(), strict=True)
                if high
            ]
            used = f"{self.seconds[USED]:.3g} s in {self.stretches} stretches, {', '.join(ranges)} rad/s"
        return f"used {used}; left out {self.reasons}"

    @property
    def reasons(self) -> str:
        """Return the reasons for which time was not used, with the seconds of each."""
        listed = [(s, reason) for reason, s in self.seconds.items() if reason != USED and s >= _LISTED_S]
        return ", ".join(f"{s:.3g} s {reason}" for s, reason in sorted(listed, reverse=True)) or "nothing"


def find_plateaus(record: JointRecord, elements: Array) -> tuple[list[Plateau], BagUse]:
    """Return the plateaus of a record, and an account of its use.

    Args:
        record: of n joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
    """
    state = np.zeros(len(record.time), dtype=np.intp)
    plateaus = []
    for seconds, fastest in _SCALES if len(state) > 1 else ():
        size = max(_LEAST_SAMPLES, round(seconds / record.period))
        steady = _steady(record, size, fastest) & (state != REASONS.index(USED))
        for begin, end in stretches(steady):
            plateau, reason = _settled(record, elements, slice(begin, end))
            state[begin:end] = REASONS.index(reason)
            if plateau is not None:
                state[begin:end] = REASONS.index(SHORT)
                state[plateau.rows] = REASONS.index(USED)
                plateaus.append(plateau)
    speeds = np.array([np.abs(elements @ velocity(record, one.rows)) * one.sliding for one in plateaus])
    ranges = np.zeros((len(elements), 2))
    for e in np.flatnonzero(speeds.any(axis=0)) if plateaus else ():
        ranges[e] = speeds[speeds[:, e] > 0.0, e].min(), speeds[:, e].max()
    seconds_of = {reason: float(np.sum(state == k)) * record.period for k, reason in enumerate(REASONS)}
    return plateaus, BagUse(record.bag, len(plateaus), ranges, seconds_of)


def velocity(record: JointRecord, rows: slice) -> Array:
    """Return the mean velocities of the joints over some samples, by their travel, rad/s, shape (n,)."""
    last = rows.stop - 1
    travel = record.position[last] - record.position[rows.start]
    return np.asarray(travel / (record.time[last] - record.time[rows.start]))


def _steady(record: JointRecord, size: int, fastest: float) -> Mask:
    """Return at which samples no joint changes its velocity between the `size` samples before and after, shape (m,)."""
    count = len(record.time)
    steady = np.zeros(count, dtype=np.bool_)
    if count <= 4 * size:
        return steady
    time = record.time
    mean = (record.position[size:] - record.position[:-size]) / (time[size:] - time[:-size])[:, None]
    change = mean[size:] - mean[:-size]
    speed = np.abs(mean[size:] + mean[:-size]) / 2.0
    # Noise and ripple from second differences of the change: an acceleration that is constant or grows evenly cancels.
    rough = np.zeros_like(change)
    rough[size:-size] = np.abs(change[2 * size :] - 2.0 * change[size:-size] + change[: -2 * size])
    spacing = max(1, round(_NOISE_WINDOW_S / record.period / _NOISE_SAMPLES))
    few = median_filter(rough[::spacing], size=(_NOISE_SAMPLES, 1), mode="nearest")
    noise = _MAD_TO_DEVIATION * _CHANGE_SHARE * np.repeat(few, spacing, axis=0)[: len(rough)]
    usual = np.maximum(_SAME_VELOCITY * speed, _REST_SHARE * speed.max(axis=1, keepdims=True))
    allowed = np.maximum(usual, np.minimum(_NOISE_SD * noise, _MOST_NOISE * speed))
    even = time[2 * size :] - time[: -2 * size] < 3.0 * size * record.period
    steady[size : count - size] = (np.abs(change) <= allowed).all(axis=1) & (speed.max(axis=1) <= fastest) & even
    return steady


def _settled(record: JointRecord, elements: Array, rows: slice) -> tuple[Plateau | None, str]:
    """Return the settled part of a steady stretch, or the reason why it is not used."""
    inputs = record.position[rows] @ elements.T
    travel = np.abs(inputs[-1] - inputs[0])
    sliding = travel * _SETTLE_SHARE >= SETTLE_DISTANCE
    if not sliding.any():
        return None, CHANGES
    late = record.time[rows] - record.time[rows.start] >= _SETTLE_S
    far = (np.abs(inputs - inputs[0])[:, sliding] >= SETTLE_DISTANCE).all(axis=1)
    ready = np.flatnonzero(late & far)
    count = len(late) - int(ready[0]) if len(ready) else 0
    if count < _BLOCK_SAMPLES:
        return None, SHORT
    begin = rows.stop - count
    if _bends(record.velocity[begin : rows.stop] @ elements[sliding].T):
        return None, BENDS
    duration = float(record.time[rows.stop - 1] - record.time[begin])
    way = float(np.abs(inputs[-1] - inputs[-count]).max())
    number = max(1, min(int(max(duration / _BLOCK_S, way / _BLOCK_TRAVEL)), count // _BLOCK_SAMPLES))
    edges = begin + np.arange(number + 1) * count // number
    return Plateau(np.column_stack([edges[:-1], edges[1:]]), sliding), USED


def _bends(speeds: Array) -> bool:
    """Return whether velocities, shape (m, k), change along a line or parabola, rather than ripple."""
    size = max(1, len(speeds) // _TREND_BLOCKS)
    means = block_means(speeds, size)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(means)), 3))[0]
    fitted = basis @ (basis.T @ means)
    scatter = np.sqrt(np.sum((means - fitted) ** 2, axis=0) / max(1, len(means) - 3))
    change = np.ptp(fitted, axis=0)
    return bool(np.any((change > _MAX_BEND * np.abs(means.mean(axis=0))) & (change > _BEND_SD * scatter)))
