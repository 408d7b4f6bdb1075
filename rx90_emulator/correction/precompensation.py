"""A correction without a channel: the corrected path as a joint trajectory, for controllers without offsets.

Such a controller treats the offsets as a part of the motion. Their velocities and accelerations enter its feed-forward,
where they cause torques that the correction does not intend: above all, an offset that moves faster than the joint
reverses the sign of the Coulomb compensation. The offsets are therefore smoothed first, and a run determines the loss
by the smoothing and the effect of the feed-forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction, PlayedCorrection
from rx90_emulator.correction.learning import run_corrected
from rx90_emulator.correction.methods import zero_phase
from rx90_emulator.correction.path import CorrectablePath, TrajectoryPath
from rx90_emulator.loop.setup import Setup

CUTOFF = 5.0
"""Default cut-off of the filter that smooths the offsets, Hz: faster offsets reverse the sign of the Coulomb
feed-forward on the shipped tasks, and make the path worse."""
_STRIDE = 2
"""Set-points from one point of the trajectory to the next: quintics through these hardly deviate from smooth ones."""


@dataclass(frozen=True, eq=False)
class Precompensation:
    """A corrected path as a trajectory.

    Attributes:
        points: the trajectory.
        plain: largest distance of the tip from the path without correction, m.
        channel: the same with the correction played as offsets.
        path: the same with the trajectory.
    """

    points: TrajectoryPoints
    plain: float
    channel: float
    path: float


def precompensate(
    setup: Setup, path: CorrectablePath, correction: Correction, cutoff: float = CUTOFF
) -> Precompensation:
    """Return the corrected path as a trajectory, and its path error on the engine.

    Args:
        setup: the arm.
        path: the path of the correction.
        correction: the learned one.
        cutoff: of the filter that smooths the offsets, Hz.

    Raises:
        ConfigError: for a cut-off that is not below half the rate of set-points.
        TrajectoryError: if the controller would refuse the trajectory; a lower cut-off makes it slower.
    """
    nominal = TrajectoryPath.of(setup, path.points, path.counted)
    count, period = len(nominal.setpoints), nominal.period
    played = PlayedCorrection.started(correction, 0).at(np.arange(count))
    offsets = np.zeros_like(nominal.setpoints)
    offsets[:, 0] = zero_phase(cutoff, period)(played)
    offsets[:, 0] -= offsets[0, 0] * np.linspace(1.0, 0.0, count)[:, None]  # it begins where the path does
    offsets[:, 1] = np.gradient(offsets[:, 0], period, axis=0)
    offsets[:, 2] = np.gradient(offsets[:, 1], period, axis=0)
    offsets[[0, -1], 1:] = 0.0
    rows = np.unique(np.append(np.arange(0, count, _STRIDE), count - 1))
    motion = (nominal.setpoints + offsets)[rows]
    motion[-1, 1:] = 0.0
    names = setup.robot.joint_names
    times = np.round(rows * period, 9).tolist()
    points = TrajectoryPoints.create(names, names, times, *(motion[:, k].tolist() for k in range(3)))
    begin, end = path.counted
    travelled, errors = TrajectoryPath.of(setup, points, (begin, min(end, float(points.times[-1])))), []
    for one, added in ((nominal, None), (nominal, correction), (travelled, None)):
        remaining = run_corrected(setup, one, added)[1].tip
        assert remaining is not None
        tip = (one.tip - remaining)[:count]
        errors.append(float(path.distance(tip[nominal.counts[: len(tip)]]).max()))
    return Precompensation(points, *errors)
