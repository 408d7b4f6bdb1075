"""When an element slides, when it rests, and when it passes through rest.

Below 0.05 rad/s (or, on slow arms, a tenth of its usual speed) the torque of an element follows the deflection of its
bristles rather than its speed. A reversal and a pause both pass below: a reversal at constant acceleration spends a
quarter of that time below a quarter of the speed, a pause most of it.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.excitation.filtering import FilteredRun

_SLOW = 0.05  # rad/s: on real arms rows below it pull Coulomb friction 10 to 25 % low
_SHARE = 0.1  # of the speed that an element exceeds in a tenth of the run
_FLOOR = 1e-3  # rad/s: an element that is never faster stands
_PAUSE = 0.5  # share of a slow stretch below a quarter of the threshold: a pause; a reversal has a quarter
_STOPS = 0.1  # of the threshold: below it an element that does not change its direction has stopped for an instant


class SlidingState(IntEnum):
    """What an element does."""

    SLIDES = 0
    PASSES = 1
    RESTS = 2


def element_states(run: FilteredRun, elements: Array) -> NDArray[np.int8]:
    """Return what each element does at the run's rows, shape (k, n_el).

    The low-pass of the torque reaches half a period of its bandwidth to both sides: a row as near to a pause as that
    counts as resting.

    Args:
        run: of n joints.
        elements: E, joint velocities to those of the elements, shape (n_el, n).
    """
    velocity = run.velocity @ elements.T
    reach = math.ceil(0.5 * run.rate / run.bandwidths.torque)
    state = np.empty((len(run.rows), len(elements)), dtype=np.int8)
    for e, speed in enumerate(velocity.T):
        threshold = slow_below(speed)
        rests, passes = _slow_stretches(speed, threshold)
        stops, _ = _slow_stretches(speed, _STOPS * threshold)
        state[:, e] = np.where(
            _near(rests | stops, reach)[run.rows], SlidingState.RESTS, passes[run.rows] * SlidingState.PASSES
        )
    return state


def slow_below(velocity: Array) -> float:
    """Return the speed below which an element counts as slow, rad/s, from its velocity in a run, shape (m,)."""
    usual = float(np.quantile(np.abs(velocity), 0.9))
    return max(min(_SLOW, _SHARE * usual), _FLOOR)


def _slow_stretches(velocity: Array, threshold: float) -> tuple[Mask, Mask]:
    """Return where an element rests and where it passes through rest, each of shape (m,)."""
    slow = np.abs(velocity) < threshold
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    rests, passes = np.zeros_like(slow), np.zeros_like(slow)
    for start, stop in edges.reshape(-1, 2).tolist():
        inner = float(np.mean(np.abs(velocity[start:stop]) < 0.25 * threshold))
        whole = start > 0 and stop < len(velocity)
        # A single sample tells no share.
        through = whole and velocity[start - 1] * velocity[stop] < 0.0 and (inner <= _PAUSE or stop - start == 1)
        (passes if through else rests)[start:stop] = True
    return rests, passes


def _near(mask: Mask, reach: int) -> Mask:
    """Return the samples within `reach` of a true one."""
    count = np.cumsum(np.concatenate([np.zeros(reach + 1), mask, np.zeros(reach)]))
    return np.asarray(count[2 * reach + 1 :] - count[: -2 * reach - 1] > 0.0)
