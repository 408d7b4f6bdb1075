"""The speeds of sweeps: spaced logarithmically, away from those at which the encoders' steps beat with the sampling.

A motor that passes nearly a whole number of encoder steps in each period of the position loop, or a simple part of
one, makes its torque ripple slowly or not at all as the recorder sees it. The samples then have a mean that is not the
torque's: on the engine it is off by up to 4 % of joint 2's friction.
"""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.wrist import coupling_matrix

_PERIOD = Rates().position_period  # s, that of joint_states too
_SHIFT = 0.1  # of the logarithm of a speed, at most
_CANDIDATES = 401
_DENOMINATORS = (1, 2, 3, 4)
_FAR = 0.25  # distance from a beat, times the denominator, beyond which the ripple averages out


def sweep_speeds(direction: Array, lowest: float, highest: float, count: int, drives: DriveParameters) -> Array:
    """Return the speeds of a direction's sweeps.

    Args:
        direction: joint velocities at speed 1, shape (6,).
        lowest: about the slowest, rad/s.
        highest: the fastest at most, rad/s.
        count: how many.
        drives: gears and encoders.

    Returns:
        Speeds, rad/s, increasing, shape (count,).
    """
    turns = drives.gear * (coupling_matrix() @ direction)
    steps = np.abs(turns) * drives.encoder_counts / (2.0 * math.pi) * _PERIOD
    steps = steps[steps > 0.0]
    spacing = math.log(highest / lowest) / (count - 1)
    shift = np.linspace(-1.0, 0.0, _CANDIDATES) * min(_SHIFT, 0.9 * spacing)
    nominal = np.geomspace(lowest, highest, count)
    return np.array([_quietest(speed * np.exp(shift), steps) for speed in nominal])


def _quietest(speeds: Array, steps: Array) -> float:
    """Return the speed at which the motors, with `steps` in a period at speed 1, shape (k,), beat least."""
    phase = np.outer(speeds, steps)
    distances = [np.abs(d * phase - np.round(d * phase)) for d in _DENOMINATORS]
    least = np.minimum(np.min(distances, axis=(0, 2)), _FAR)
    # Of equally good ones the nearest to the nominal speed, which is the last.
    return float(speeds[np.flatnonzero(least >= least.max() - 1e-12)[-1]])
