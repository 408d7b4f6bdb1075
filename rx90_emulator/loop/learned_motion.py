"""The motion that a correction is learned on, and the check of it before a correction is played."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import tip_position
from rx90_common.description.urdf import robot_name
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.correction import Correction, LearnedMotion
from rx90_controller.trajectory.points import trajectory_identity
from rx90_emulator.loop.setup import Setup


def required_setpoints(setup: Setup, points: TrajectoryPoints) -> Array:
    """Return set-points 0, 1, ... of an arm along a trajectory, shape (n, 3, joints).

    Raises:
        TrajectoryError: if the controller would refuse the trajectory.
    """
    generator = TrajectoryGenerator(
        setup.controller.limits(setup.robot), setup.rates.position_period, points.position[0]
    )
    return generator.setpoints(0, generator.accept(points, 0, None).end)


def learned_motion(setup: Setup, points: TrajectoryPoints) -> LearnedMotion:
    """Return the motion of an arm along a trajectory.

    Raises:
        TrajectoryError: if the controller would refuse the trajectory.
    """
    tip = tip_position(setup.robot.chain, required_setpoints(setup, points)[:, 0])
    steps = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    speed = float(steps.max()) / setup.rates.position_period
    start = tuple(points.position[0].tolist())
    return LearnedMotion(
        robot_name(setup.robot.urdf),
        trajectory_identity(points),
        speed,
        float(points.times[-1]),
        start,
    )


def check_correction(
    setup: Setup, points: TrajectoryPoints, correction: Correction, name: str
) -> None:
    """Check that a correction, which messages call `name`, was learned on this robot and trajectory, if on any.

    Raises:
        ConfigError: saying on which it was learned.
    """
    learned = correction.learned_on
    if learned is None:
        return
    robot = robot_name(setup.robot.urdf)
    if learned.robot != robot:
        raise ConfigError(
            f"{name} was learned on the robot {learned.robot!r}, this one is {robot!r}; accepted: the same robot"
        )
    if learned.identity != trajectory_identity(points):
        raise ConfigError(
            f"{name} was learned on {learned.path}, this is {learned_motion(setup, points).path}; "
            "accepted: the same trajectory"
        )
