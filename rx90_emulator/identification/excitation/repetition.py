"""Which instants of excitation runs are repetitions of the same motion: periods of a run, runs that are played again.

What a model leaves out (ripple, load, cables) follows the motion and comes back with it. A motion that was recorded ten
times says no more of its misfit than one recording; deviations that take the repetitions for independent are up to the
root of ten too small.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import correlate

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.excitation.filtering import FilteredRun

_SAME = 0.95  # similarity of velocities from which on two stretches are the same motion
_OTHER = 0.5  # similarity below which a lag has left the neighbourhood of 0
_COMMON = 0.3  # share of the motion's energy that two stretches have in common, at least
_LIKE = 0.01  # relative difference between the row rates of runs that can be compared


def phases(runs: Sequence[FilteredRun]) -> list[tuple[int, Index]]:
    """Return for each run the number of its motion and the phase of each of its rows' instants, shape (k,).

    Instants with the same motion and phase are repetitions of each other.
    """
    scale = np.sqrt(np.mean(np.concatenate([run.velocity**2 for run in runs]), axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    motions: list[tuple[Array, float, int]] = []
    found = []
    for run in runs:
        velocity, rate = run.velocity[run.rows] / scale, run.rate / run.down
        number, shift = _known(velocity, rate, motions)
        if number == len(motions):
            motions.append((velocity, rate, _period(velocity)))
        place = np.arange(len(velocity)) + shift
        period = motions[number][2]
        found.append((number, place % period if period else place))
    # A run that began earlier than the first of its motion has places before 0.
    earliest = {number: min(int(p.min()) for k, p in found if k == number and len(p)) for number, _ in found}
    return [(number, place - earliest[number]) for number, place in found]


def _known(velocity: Array, rate: float, motions: Sequence[tuple[Array, float, int]]) -> tuple[int, int]:
    """Return the motion that a run repeats, by how many rows it begins later there; a new number if it repeats none."""
    for number, (other, its_rate, _) in enumerate(motions):
        if abs(rate / its_rate - 1.0) < _LIKE:
            alike, shared = _similarity(other, velocity)
            best = int(np.argmax(np.where(shared > _COMMON, alike, -1.0)))
            if alike[best] > _SAME and shared[best] > _COMMON:
                return number, best - (len(velocity) - 1)
    return len(motions), 0


def _period(velocity: Array) -> int:
    """Return the period of a run in rows, velocities of shape (k, n); 0 if it does not repeat itself."""
    alike, shared = _similarity(velocity, velocity)
    alike, shared = alike[len(velocity) - 1 :], shared[len(velocity) - 1 :]
    left = np.flatnonzero(alike < _OTHER)
    candidates = np.flatnonzero(_peaks(alike) & (alike > _SAME) & (shared > _COMMON))
    candidates = candidates[candidates > (left[0] if len(left) else len(alike))]
    return int(candidates[0]) if len(candidates) else 0


def _peaks(values: Array) -> Mask:
    padded = np.pad(values, 1, constant_values=-np.inf)
    return np.asarray((values >= padded[:-2]) & (values >= padded[2:]))


def _similarity(first: Array, second: Array) -> tuple[Array, Array]:
    """Return how alike two motions are at each lag, 1 for the same, and the share of the smaller energy in the overlap.

    At lag number l, row k of `second` lies on row k + l - (len(second) - 1) of `first`.
    """
    product = sum(correlate(a, b, method="fft") for a, b in zip(first.T, second.T, strict=True))
    energy, other = (np.concatenate([[0.0], np.cumsum((values**2).sum(axis=1))]) for values in (first, second))
    lag = np.arange(-(len(second) - 1), len(first))
    begin, end = np.maximum(lag, 0), np.minimum(lag + len(second), len(first))
    mine, its = energy[end] - energy[begin], other[end - lag] - other[begin - lag]
    least = max(min(energy[-1], other[-1]), 1e-300)
    return 2.0 * product / np.maximum(mine + its, 1e-300 + 1e-9 * least), np.minimum(mine, its) / least
