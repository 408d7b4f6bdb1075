"""The corrected path as a joint trajectory, for controllers without a channel for offsets, such as a real cabinet.

Such a controller takes the offsets for a part of the motion: their velocities and accelerations enter its feed-forward.
Above all, an offset that moves faster than the joint reverses the sign of the Coulomb compensation. So the offsets are
smoothed first, and much of the correction is lost.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rx90_common.base.errors import ConfigError
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction, PlayedCorrection
from rx90_emulator.correction.learning import run_corrected
from rx90_emulator.correction.path import CorrectablePath, TrajectoryPath
from rx90_emulator.loop.setup import Setup

CUTOFF = 5.0
"""Default cut-off of the filter that smooths the offsets, Hz: faster offsets reverse the sign of the Coulomb
feed-forward on the shipped tasks, and make the path worse."""
_ORDER = 2  # of the Butterworth filter
_STRIDE = 2
"""Set-points from one point of the trajectory to the next: quintics through these hardly deviate from smooth ones."""


def corrected_trajectory(
    setup: Setup, path: CorrectablePath, correction: Correction, cutoff: float = CUTOFF
) -> TrajectoryPoints:
    """Return the corrected path as a trajectory.

    Args:
        setup: the arm.
        path: the path of the correction.
        correction: the learned one.
        cutoff: of the filter that smooths the offsets, Hz.
    """
    nominal = TrajectoryPath.of(setup, path.points, path.counted)
    count = len(nominal.setpoints)
    period = nominal.period
    played = PlayedCorrection.started(correction, 0).at(np.arange(count))
    if not cutoff < 0.5 / period:
        raise ConfigError(
            f"cutoff is {cutoff:g} Hz; accepted: below {0.5 / period:g} Hz, half the rate of set-points"
        )
    from scipy.signal import butter, sosfiltfilt  # takes a while

    # forwards and backwards, extended by the last value
    sections = butter(_ORDER, cutoff, fs=1.0 / period, output="sos")
    offset = sosfiltfilt(sections, played, axis=0, padtype="constant")
    offset -= offset[0] * np.linspace(1.0, 0.0, count)[:, None]  # it begins where the path does
    velocity = np.gradient(offset, period, axis=0)
    acceleration = np.gradient(velocity, period, axis=0)
    motion = nominal.setpoints + np.stack([offset, velocity, acceleration], axis=1)
    motion[[0, -1], 1:] = nominal.setpoints[[0, -1], 1:]
    motion[-1, 1:] = 0.0
    rows = np.unique(np.append(np.arange(0, count, _STRIDE), count - 1))
    names = setup.robot.joint_names
    times = np.round(rows * period, 9).tolist()
    return TrajectoryPoints.create(
        names, names, times, *(motion[rows, k].tolist() for k in range(3))
    )


def travelled_error(setup: Setup, path: CorrectablePath, points: TrajectoryPoints) -> float:
    """Return the largest distance of the tip from a path, m, where a trajectory is followed on the engine.

    Raises:
        TrajectoryError: if the controller would refuse the trajectory; a lower cut-off makes it slower.
    """
    nominal = TrajectoryPath.of(setup, path.points, path.counted)
    _, measured = run_corrected(setup, replace(nominal, points=points))
    assert measured.tip is not None
    counts = nominal.counts
    return float(path.distance((nominal.tip - measured.tip)[counts], nominal.counted_times).max())
