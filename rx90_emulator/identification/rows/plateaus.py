"""Find the plateaus of a record: stretches in which every joint keeps its velocity.

A joint keeps its velocity where the mean velocities before and after an instant agree. They are compared over times of
several lengths, the long ones only for slow motion, where ripple is slow and noise large. Of a plateau, the beginning
is left out, until servo loops and bristles have settled; one whose velocity bends, as at the crest of a wave, is left
out as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.quoting import counted
from rx90_emulator.identification.records import BagSource, JointRecord, block_means, stretches

SETTLE_DISTANCE = 5e-3
"""Travel after which a bristle has its steady deflection, rad: ten times g or more for joints of this class."""
_SCALES = ((0.4, 0.025), (0.1, 0.1), (0.02, np.inf))
"""Times over which velocities are compared, s, each with the largest speed for it, rad/s."""
_LEAST_SAMPLES = 3  # over which a velocity is a mean: single samples at 67 Hz are mostly noise
_SAME_VELOCITY = 0.02  # largest change within a plateau, as a share of its velocity, or
_REST_SHARE = 0.01  # of the fastest joint's velocity: moving joints shake those at rest
_NOISE_SD = 6.0  # standard deviations of the noise of a change that are no change
_MOST_NOISE = 0.75  # of the velocity, which keeps its sign
_NOISE_WINDOW_S = 2.0  # over which the noise is estimated, from
_NOISE_SAMPLES = 21
# and that of a change over that of its second difference, for white noise of positions:
_MAD_TO_DEVIATION = 1.4826
_CHANGE_SHARE = np.sqrt(6.0 / 70.0)
# for the servo loops after a change of velocity: their integrators' pole is near 20 /s
_SETTLE_S = 0.25
# of a plateau, within which bristles must settle for the element to count as sliding
_SETTLE_SHARE = 0.5
_TREND_BLOCKS = 8  # of a plateau, to which a parabola is fitted
_MAX_BEND = 0.02  # of the velocity, change of the parabola over the plateau, if
_BEND_SD = 3.0  # standard deviations of the blocks' scatter or more
_BLOCK_S = 0.25
_BLOCK_TRAVEL = 0.02  # rad: the rigid torque is nearly linear within it
_BLOCK_SAMPLES = 8


class Plateau(NamedTuple):
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


class BagUse(NamedTuple):
    """What was used of one bag of sweeps.

    Attributes:
        bag: the bag.
        stretches: number of plateaus.
        speeds: slowest and fastest speed of each element, rad/s, 0 if there is none, shape (n_el, 2).
        seconds: of the plateaus together.
        unsettled: stretches of constant velocity that were too short for servo loops and bristles to settle.
        bent: stretches that were left out because their velocity bends, as at the crest of a wave.
    """

    bag: BagSource
    stretches: int
    speeds: Array
    seconds: float
    unsettled: int
    bent: int

    def text(self, names: Sequence[str]) -> str:
        """Return it as a line, with the elements by these names."""
        ranges = [
            f"{name} {low:.3g} to {high:.3g}"
            for name, (low, high) in zip(names, self.speeds.tolist(), strict=True)
            if high
        ]
        used = f"{self.seconds:.3g} s of {self.bag.duration:.3g} s in {counted(self.stretches, 'plateau')}"
        return f"used {', '.join([used, *ranges])}{' rad/s' if ranges else ''}; {self.left_out}"

    @property
    def left_out(self) -> str:
        """Return in words which stretches of constant velocity were not used."""
        return f"left out {self.unsettled} that are too short to settle, {self.bent} whose velocity bends"


def find_plateaus(record: JointRecord, elements: Array) -> tuple[list[Plateau], BagUse]:
    """Return the plateaus of a record, and an account of its use.

    Args:
        record: of n joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
    """
    used = np.zeros(len(record.time), dtype=np.bool_)
    plateaus = []
    unsettled = 0
    bent = 0
    for seconds, fastest in _SCALES if len(used) > 1 else ():
        size = max(_LEAST_SAMPLES, round(seconds / record.period))
        for begin, end in stretches(_steady(record, size, fastest) & ~used):
            rows = slice(begin, end)
            sliding = _sliding(record, elements, rows)
            if not sliding.any():
                continue
            rows = _settled(record, elements[sliding], rows)
            if rows.stop - rows.start < _BLOCK_SAMPLES:
                unsettled += 1
            elif _bends(record.velocity[rows] @ elements[sliding].T):
                bent += 1
            else:
                used[rows] = True
                plateaus.append(Plateau(_blocks(record, elements, rows), sliding))
    speeds = np.array(
        [
            np.abs(elements @ velocity(record, plateau.rows)) * plateau.sliding
            for plateau in plateaus
        ]
    )
    ranges = np.zeros((len(elements), 2))
    for e in np.flatnonzero(speeds.any(axis=0)) if plateaus else ():
        ranges[e] = speeds[speeds[:, e] > 0.0, e].min(), speeds[:, e].max()
    lasting = float(used.sum()) * record.period
    return plateaus, BagUse(record.bag, len(plateaus), ranges, lasting, unsettled, bent)


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
    lasting = time[size:] - time[:-size]
    mean = (record.position[size:] - record.position[:-size]) / lasting[:, None]
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
    same = (np.abs(change) <= allowed).all(axis=1)
    steady[size : count - size] = same & (speed.max(axis=1) <= fastest) & even
    return steady


def _sliding(record: JointRecord, elements: Array, rows: slice) -> Mask:
    """Return which elements slide and do not stick in a steady stretch, shape (n_el,)."""
    travel = np.abs((record.position[rows.stop - 1] - record.position[rows.start]) @ elements.T)
    return np.asarray(travel * _SETTLE_SHARE >= SETTLE_DISTANCE)


def _settled(record: JointRecord, sliding: Array, rows: slice) -> slice:
    """Return the settled part of a steady stretch, for the rows of E of the elements that slide."""
    inputs = record.position[rows] @ sliding.T
    late = record.time[rows] - record.time[rows.start] >= _SETTLE_S
    ready = np.flatnonzero(late & (np.abs(inputs - inputs[0]) >= SETTLE_DISTANCE).all(axis=1))
    return slice(rows.start + int(ready[0]) if len(ready) else rows.stop, rows.stop)


def _blocks(record: JointRecord, elements: Array, rows: slice) -> Index:
    """Return first and last sample (exclusive) of each block of a plateau, shape (b, 2)."""
    count = rows.stop - rows.start
    duration = float(record.time[rows.stop - 1] - record.time[rows.start])
    travel = record.position[rows.stop - 1] - record.position[rows.start]
    way = float(np.abs(travel @ elements.T).max())
    number = max(
        1, min(int(max(duration / _BLOCK_S, way / _BLOCK_TRAVEL)), count // _BLOCK_SAMPLES)
    )
    edges = rows.start + np.arange(number + 1) * count // number
    return np.column_stack([edges[:-1], edges[1:]])


def _bends(speeds: Array) -> bool:
    """Return whether velocities, shape (m, k), change along a line or parabola, rather than ripple."""
    size = max(1, len(speeds) // _TREND_BLOCKS)
    means = block_means(speeds, size)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(means)), 3))[0]
    fitted = basis @ (basis.T @ means)
    scatter = np.sqrt(np.sum((means - fitted) ** 2, axis=0) / max(1, len(means) - 3))
    change = np.ptp(fitted, axis=0)
    large = change > _MAX_BEND * np.abs(means.mean(axis=0))
    return bool(np.any(large & (change > _BEND_SD * scatter)))
