"""Block means of the plateaus of records, and an account of what was used of each bag.

A plateau is a stretch in which every joint keeps its velocity, except for ripple and noise. The time that the servo
loop and the bristles need to settle is left out at its beginning; the rest is cut into blocks, each with its own
velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import fdtrc

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.records import BagSource, JointRecord, block_means, stretches

USED = "used"
AT_REST = "at rest"
CHANGES = "changes of velocity"
ACCELERATES = "steady acceleration or a crest"
SETTLES = "settling"
SHORT = "too short"
LITTLE_TRAVEL = "travel of less than 10 mrad"
UNSTEADY = "blocks of another velocity"
REASONS = (CHANGES, AT_REST, LITTLE_TRAVEL, SETTLES, SHORT, ACCELERATES, UNSTEADY, USED)
"""Use of a sample, or the reason why it was not used."""
SETTLE_DISTANCE = 5e-3
"""Travel after which a bristle has its steady deflection, rad: ten times g or more for joints of this class."""
_SCALES = ((0.02, np.inf), (0.1, 0.1), (0.4, 0.025))
"""Times over which velocities are compared, s, each with the largest speed for it, rad/s: at creep speed the ripple is
slow, and changes within 10 mrad of travel are ignored."""

# Bins of velocity, from which plateaus are made.
_BIN_SAMPLES = 3  # in a bin: a single sample at 67 Hz is mostly noise
_MIN_BINS = 4
_NOISE_SD = 6.0  # standard deviations of a bin's velocity that end a plateau
_VELOCITY_CHANGE = 0.02  # largest change within a plateau, as a share of its velocity, or
_REST_SHARE = 0.01  # of the fastest joint's velocity: moving joints shake those at rest
_MAX_VELOCITY_ERROR = 0.75  # of the plateau's mean, for any noise: the velocity keeps its sign
# of the joint's own fastest velocity, or rad/s, that noise may explain
_NOISE_CAP_SHARE = 0.01
_MIN_NOISE_CAP = 3e-3
# over which the noise is estimated
_NOISE_WINDOW_S = 1.0
_NOISE_WINDOW_BINS = 10
_END_S = 0.06  # s at the end of a plateau in which the next change of velocity may have begun
# The trend of velocity within a plateau.
_TREND_BINS = 5  # least number of bins for a test of acceleration
# of the velocity, and probability below which such a change is significant
_MAX_TREND = 0.003
_P_VALUE = 0.01
_HALF_S = 1.0  # s, least length of a plateau whose second half is tried alone: the first may be a slow start
_CONTEXT_S = (0.2, 1.0)  # s before and after a short stretch, at least and at most, for the test whether it is constant
_CONTEXT_CHANGE = 0.15  # largest change of the velocity there
# The blocks of a settled plateau.
_SETTLE_S = 0.25  # s, for the servo loops after a change of velocity; their integrators' pole is near 20 /s
_SETTLE_SHARE = 0.5  # of a plateau, within which the bristles must settle for the element to count as sliding
# largest size, s and rad: the rigid torque is nearly linear within it
_BLOCK_S = 0.25
_BLOCK_TRAVEL = 0.02
_BLOCK_SAMPLES = 8  # least size
_BLOCK_CHANGE = 0.75  # largest deviation of a block's velocity, as a share of the plateau's
_OUTLIER_SD = 5.0  # standard deviations from a block's median
# The account.
_REST_TRAVEL = 1e-3  # rad below which nothing moves
# s from which a reason is listed, and from which an unused stretch is
_LISTED_S = 0.05
_UNUSED_S = 0.5


@dataclass(frozen=True, eq=False)
class BagUse:
    """The parts of one bag of sweeps that were used.

    Attributes:
        bag: the bag.
        stretches: number of stretches of constant velocity that were used.
        seconds: their total duration.
        speeds: rad/s, slowest and fastest used speed of each element, 0 if there is none, shape (n_el, 2).
        left_out: unused seconds by reason, the most frequent reason first.
        unused: mean speeds of the elements, rad/s, in stretches that were not used, shape (u, n_el); 0 at rest.
    """

    bag: BagSource
    stretches: int
    seconds: float
    speeds: Array
    left_out: Mapping[str, float]
    unused: Array

    def text(self, names: Sequence[str]) -> str:
        """Return it as a line, with the elements by these names."""
        used = "NOTHING"
        rest = self.reasons
        if self.stretches:
            ranges = [
                f"{name} {low:.3g}" + (f" to {high:.3g}" if f"{low:.3g}" != f"{high:.3g}" else "")
                for name, (low, high) in zip(names, self.speeds.tolist(), strict=True)
                if high
            ]
            used = f"{self.seconds:.3g} s in {self.stretches} stretches, {', '.join(ranges)} rad/s"
        return f"used {used}" + (f"; left out {rest}" if rest else "")

    @property
    def reasons(self) -> str:
        """Return the reasons for which time was not used, with the seconds of each."""
        return ", ".join(f"{seconds:.3g} s {why}" for why, seconds in self.left_out.items())


@dataclass(frozen=True, eq=False)
class Blocks:
    """Block means of m blocks of plateaus, of n joints with n_el friction elements.

    Attributes:
        position: rad, shape (m, n).
        velocity: of the straight line fitted to the plateau's velocity, rad/s, shape (m, n).
        acceleration: slope of that line, rad/s^2, shape (m, n).
        torque: of the drives, Nm, shape (m, n).
        sliding: whether each friction element slides and does not stick, shape (m, n_el).
        plateau: number of each block's plateau, shape (m,).
        count: samples in each mean, shape (m,).
        source: number of the record, shape (m,).
        time: in the series, s, shape (m,).
        noise: covariance of the torque's samples, Nm^2, shape (n, n).
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    sliding: Mask
    plateau: NDArray[np.int64]
    count: Array
    source: NDArray[np.int64]
    time: Array
    noise: Array


def find_blocks(records: Sequence[JointRecord], elements: Array) -> tuple[Blocks, tuple[BagUse, ...]]:
    """Cut records into plateaus, and these into blocks; also return the account of each record.

    Args:
        records: of the same joints.
        elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
    """
    parts: list[dict[str, Array]] = []
    usage = []
    covariances = []
    # Records begin by their stamps or, if these overlap, one after the other.
    order = sorted(records, key=lambda record: float(record.time[0]))
    disjoint = all(a.time[-1] <= b.time[0] for a, b in pairwise(order))
    begin = 0.0
    for source, record in enumerate(records):
        state, cut = _plateaus(record, elements)
        shift = 0.0 if disjoint else begin - float(record.time[0])
        velocities = []
        for rows, sliding in cut:
            part, covariance = _block_means(record, rows)
            velocities.append(part["velocity"] @ elements.T * sliding)
            numbers = {"sliding": sliding, "plateau": len(parts), "source": source}
            part |= {name: np.repeat([value], len(rows), axis=0) for name, value in numbers.items()}
            parts.append(part | {"time": part["time"] + shift})
            covariances.append(covariance)
        begin += float(record.time[-1] - record.time[0])
        usage.append(_account(record, elements, state, velocities))
    if not parts:
        each = "; ".join(f"{record.source}: {use.reasons}" for record, use in zip(records, usage, strict=True))
        raise IdentificationError(
            f"{each or 'no bag'}: no stretch of constant velocity; accepted: sweeps at constant velocity"
        )
    joined: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    weights = np.array([part["count"].sum() for part in parts])
    noise = np.einsum("p,pij->ij", weights / weights.sum(), np.array(covariances))
    return Blocks(**joined, noise=noise), tuple(usage)


def _plateaus(record: JointRecord, elements: Array) -> tuple[Array, list[tuple[NDArray[np.int64], Mask]]]:
    """Return the index in REASONS of each sample, and for each plateau its blocks' samples (b, m) and what slides."""
    state = np.full(len(record.time), REASONS.index(CHANGES))
    cut: list[tuple[NDArray[np.int64], Mask]] = []
    if len(record.time) < 2:
        return state, cut
    top = np.percentile(np.abs(record.velocity), 99.0, axis=0)
    for seconds, fastest in _SCALES:
        size = max(_BIN_SAMPLES, round(seconds / record.period))
        for begin, end in stretches(state != REASONS.index(USED)):
            for rows in _steady_stretches(record, slice(begin, end), size, top):
                duration, travel = _travel(record, elements, rows)
                if travel.max() > fastest * duration:
                    continue
                sliding = travel * _SETTLE_SHARE >= SETTLE_DISTANCE
                if not sliding.any():
                    state[rows] = REASONS.index(LITTLE_TRAVEL if travel.max() > _REST_TRAVEL else AT_REST)
                    continue
                state[rows] = REASONS.index(SETTLES)
                kept, reason = _settled_part(record, elements, rows, size, sliding)
                if reason:
                    state[kept] = REASONS.index(reason)
                    continue
                state[kept] = REASONS.index(SHORT)
                blocks, steady = _blocks(record, elements, kept, sliding)
                state[blocks] = REASONS.index(UNSTEADY)
                state[blocks[steady]] = REASONS.index(USED)
                if steady.any():
                    cut.append((blocks[steady], sliding))
    return state, cut


def _travel(record: JointRecord, elements: Array, rows: slice) -> tuple[float, Array]:
    """Return duration, s, and the elements' travel, rad: over time more precise than the drives' mean velocities."""
    first = rows.start
    last = rows.stop - 1
    return float(record.time[last] - record.time[first]), np.abs(
        elements @ (record.position[last] - record.position[first])
    )


def _steady_stretches(record: JointRecord, rows: slice, size: int, fastest: Array) -> list[slice]:
    """Return the samples of each stretch of a part of a record in which every joint keeps its velocity.

    Args:
        record: whose samples these are.
        rows: of the record.
        size: samples in a bin.
        fastest: velocity of each joint in the whole record, rad/s, shape (n,).
    """
    time = record.time[rows]
    velocity = block_means(record.velocity[rows], size)
    period = record.period
    count = len(velocity)
    if count < _MIN_BINS:
        return []
    first = np.arange(count) * size
    gap = time[np.minimum(first + size, len(time) - 1)] - time[first] > 2.0 * size * period
    # Noise from third differences, whose variance is 20 times that of a velocity: an acceleration, and its change,
    # cancel. The median over the neighbouring bins excludes jumps, and separates rest from motion.
    third = np.abs(np.diff(velocity, n=3, axis=0, prepend=velocity[:1], append=velocity[-2:]))
    span = max(_NOISE_WINDOW_BINS, round(_NOISE_WINDOW_S / (size * period)))
    middle = [median_filter(column, 2 * (span // 2) + 1, mode="nearest") for column in third.T]
    noise = 1.4826 / np.sqrt(20.0) * np.stack(middle, axis=1)
    cap = np.maximum(_NOISE_CAP_SHARE * fastest, _MIN_NOISE_CAP)
    # Slow ripple hardly shows in third differences; jumps contain it, but accelerations, too, hence the limit.
    jumps = _NOISE_SD * 1.4826 / np.sqrt(2.0) * np.median(np.abs(np.diff(velocity, axis=0)), axis=0)
    tolerance = np.maximum(_NOISE_SD * noise + 1e-9, np.minimum(jumps, cap))
    number = np.empty(count, dtype=np.int64)
    _number_plateaus(velocity, tolerance, gap, cap, (_VELOCITY_CHANGE, _REST_SHARE, _MAX_VELOCITY_ERROR), number)
    edges = np.flatnonzero(np.diff(number, prepend=-1, append=number[-1] + 1))
    # The first bin and the last ones may contain a part of a change of velocity.
    end = max(1, round(_END_S / (size * period)))
    cut = [(int(start + 1), int(stop - end)) for start, stop in pairwise(edges)]
    return [slice(rows.start + a * size, rows.start + b * size) for a, b in cut if b - a > 1]


@kernel
def _number_plateaus(
    velocity: Array, tolerance: Array, gap: Mask, cap: Array, shares: tuple[float, float, float],
    number: NDArray[np.int64],
) -> None:  # fmt: skip
    """Number the runs of bins whose velocities stay near the run's mean, shape (bins, n) to (bins,)."""
    bins, joints = velocity.shape
    relative, at_rest, steady = shares
    mean = velocity[0].copy()
    samples = 1
    current = 0
    number[0] = 0
    for k in range(1, bins):
        same = not gap[k] and not gap[k - 1]
        fastest = np.abs(mean).max()
        for j in range(joints):
            noise = min(tolerance[k, j], max(steady * abs(mean[j]), cap[j]))
            if abs(velocity[k, j] - mean[j]) > max(noise, relative * abs(mean[j]), at_rest * fastest):
                same = False
        if same:
            samples += 1
            for j in range(joints):
                mean[j] += (velocity[k, j] - mean[j]) / samples
        else:
            current += 1
            samples = 1
            for j in range(joints):
                mean[j] = velocity[k, j]
        number[k] = current


def _settled_part(record: JointRecord, elements: Array, rows: slice, size: int, sliding: Mask) -> tuple[slice, str]:
    """Return the settled part of a plateau with constant velocity, and the reason if it cannot be used."""
    inputs = record.position[rows] @ elements[sliding].T
    along = inputs * np.sign(inputs[-1] - inputs[0])
    travelled = (along - np.minimum.accumulate(along, axis=0)).min(axis=1)
    late = record.time[rows] - record.time[rows][0] >= _SETTLE_S
    ready = np.flatnonzero(late & (travelled >= SETTLE_DISTANCE))
    start = int(rows.start + ready[0]) if len(ready) else rows.stop
    if (rows.stop - start) // size < _TREND_BINS:
        return slice(start, rows.stop), SHORT
    moving = (elements[sliding] != 0.0).any(axis=0)
    half = (start + rows.stop) // 2
    # Half of a wave's crest, if short, would look straight.
    long = float(record.time[rows.stop - 1] - record.time[half]) >= _HALF_S
    for begin in (start, half)[: 1 + long]:
        settled = slice(begin, rows.stop)
        if not _accelerates(record, settled, size, moving):
            around = settled if long else _with_context(record, elements[sliding], settled, size)
            if around == settled or not _accelerates(record, around, size, moving):
                return settled, ""
    return settled, ACCELERATES


def _accelerates(record: JointRecord, rows: slice, size: int, moving: Mask) -> bool:
    """Return whether a moving joint speeds up, slows down or turns at the crest of a wave, rather than ripples.

    A parabola through the velocities changes by more than 0.3 %, and is significant (F test that accounts for the first
    autocorrelation of the residuals).
    """
    velocity = block_means(record.velocity[rows], size)
    count = len(velocity)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), 3))[0]
    fitted = basis @ (basis.T @ velocity)
    residual = velocity - fitted
    mean = velocity.mean(axis=0)
    power = np.maximum(np.sum(residual**2, axis=0), 1e-24)
    repeated = np.clip(np.sum(residual[1:] * residual[:-1], axis=0) / power, 0.0, 0.95)
    free = np.maximum((count - 3) * (1.0 - repeated) / (1.0 + repeated), 1.0)
    explained = np.sum((fitted - mean) ** 2, axis=0) / 2.0
    chance = fdtrc(2.0, free, explained / power * free)
    change = np.ptp(fitted, axis=0)
    return bool(np.any(moving & (change > _MAX_TREND * np.abs(mean)) & (chance < _P_VALUE)))


def _with_context(record: JointRecord, elements: Array, kept: slice, size: int) -> slice:
    """Return a short stretch extended by its neighbourhood where this has nearly its velocity on both sides.

    Noise cuts a wave into stretches too short to show its curvature; a stretch between two changes of velocity is not
    extended.
    """
    usual = (record.velocity[kept] @ elements.T).mean(axis=0)
    period = float(record.time[kept.stop - 1] - record.time[kept.start]) / (kept.stop - 1 - kept.start)
    least, most = (round(seconds / period / size) for seconds in _CONTEXT_S)
    bins = [0, 0]
    for side, (begin, step) in enumerate(((kept.start - size, -size), (kept.stop, size))):
        for at in range(begin, begin + most * step, step):
            part = record.velocity[max(at, 0) : at + size] @ elements.T
            whole = at >= 0 and len(part) == size
            if not whole or (np.abs(part.mean(axis=0) - usual) > _CONTEXT_CHANGE * np.abs(usual)).any():
                break
            bins[side] += 1
    if min(bins) < max(1, least):
        return kept
    return slice(kept.start - bins[0] * size, kept.stop + bins[1] * size)


def _blocks(record: JointRecord, elements: Array, kept: slice, sliding: Mask) -> tuple[NDArray[np.int64], Mask]:
    """Return the samples of each block (b, m), and which blocks have a velocity near that of the plateau.

    Either the mean velocity or the travel over time suffices: the first is noisy, the second has encoder steps.
    """
    count = kept.stop - kept.start
    time = record.time
    position = record.position
    if count < _BLOCK_SAMPLES:
        return np.zeros((0, 1), dtype=np.int64), np.zeros(0, dtype=np.bool_)
    duration, travel = _travel(record, elements, kept)
    length = min(_BLOCK_S, _BLOCK_TRAVEL / max(float(travel.max()) / duration, 1e-9))
    size = min(max(_BLOCK_SAMPLES, int(length * (count - 1) / duration)), count)
    rows = kept.start + np.arange(count // size * size).reshape(-1, size)
    inputs = elements[sliding].T

    def speed(first: NDArray[np.int64], last: NDArray[np.int64]) -> Array:
        return np.asarray((position[last] - position[first]) @ inputs / (time[last] - time[first])[:, None])

    usual = speed(rows[:1, 0], rows[-1:, -1])
    steady = np.zeros(len(rows), dtype=np.bool_)
    for own in (speed(rows[:, 0], rows[:, -1]), record.velocity[rows].mean(axis=1) @ inputs):
        steady |= (np.abs(own - usual) <= _BLOCK_CHANGE * np.abs(usual)).all(axis=1)
    return rows, steady


def _block_means(record: JointRecord, rows: NDArray[np.int64]) -> tuple[dict[str, Array], Array]:
    """Return means over the blocks of a plateau, of its samples (b, m), and the covariance of the torque's samples."""
    samples = rows.ravel()
    mean_time = record.time[rows].mean(axis=1)
    centre = record.time[samples].mean()
    spread = record.time[samples] - centre
    slope = spread @ record.velocity[samples] / (spread @ spread)
    torque = record.torque[rows]
    distance = np.abs(torque - np.median(torque, axis=1, keepdims=True))
    good = distance <= _OUTLIER_SD * 1.4826 * np.median(distance, axis=1, keepdims=True) + 1e-12
    used = good.sum(axis=1)
    steps = np.diff(torque, axis=1).reshape(-1, torque.shape[2])
    usual = (np.abs(steps) <= _OUTLIER_SD * 1.4826 * np.median(np.abs(steps), axis=0) + 1e-12).all(axis=1)
    steps = steps[usual] if usual.any() else steps
    means = {
        "position": record.position[rows].mean(axis=1),
        "velocity": record.velocity[samples].mean(axis=0) + (mean_time[:, None] - centre) * slope,
        "acceleration": np.tile(slope, (len(rows), 1)),
        "torque": np.where(good, torque, 0.0).sum(axis=1) / used,
        "count": used.min(axis=1).astype(np.float64),
        "time": mean_time,
    }
    return means, steps.T @ steps / len(steps) / 2.0


def _account(record: JointRecord, elements: Array, state: Array, velocities: Sequence[Array]) -> BagUse:
    """Return the account of a record, from the state of its samples and its plateaus' velocities (b, n_el)."""
    speeds = np.zeros((len(elements), 2))
    for e in range(len(elements)):
        own_speeds = [abs(float(v[:, e].mean())) for v in velocities if v[:, e].any()]
        if own_speeds:
            speeds[e] = min(own_speeds), max(own_speeds)
    seconds = {why: float(np.sum(state == k)) * record.period for k, why in enumerate(REASONS)}
    used = seconds.pop(USED)
    listed = sorted(((why, s) for why, s in seconds.items() if s >= _LISTED_S), key=lambda pair: -pair[1])
    unused = [np.zeros((0, len(elements)))]
    for begin, end in stretches(~np.isin(state, [REASONS.index(why) for why in (USED, AT_REST, SETTLES)])):
        lasted, travel = _travel(record, elements, slice(begin, end))
        if lasted >= _UNUSED_S and travel.max() > _REST_TRAVEL:
            unused.append(np.where(travel > _REST_TRAVEL, travel / lasted, 0.0)[None])
    return BagUse(record.bag, len(velocities), used, speeds, dict(listed), np.concatenate(unused))
