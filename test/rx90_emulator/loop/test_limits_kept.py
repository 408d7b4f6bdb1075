"""What the controller accepts keeps the simulated arm within its limits; what would drive it past them is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup

REST = [0.0] * 6


def to_limit(setup: Setup, joint: int, sign: float, ramp: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return where one joint starts and ends, at its limit, and the time it takes with ramps of `ramp` s.

    Between them it moves at its full speed for 0.1 s. The others stay.
    """
    robot = setup.robot
    speed = robot.max_velocity[joint]
    end = np.zeros(6)
    end[joint] = (robot.upper if sign > 0 else robot.lower)[joint]
    start = end.copy()
    start[joint] -= sign * speed * (ramp + 0.1)
    return start, end, 2.0 * ramp + 0.1


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("joint", range(6))
def test_the_fastest_motion_to_a_limit_stays_within_it(shipped: Setup, joint: int, sign: float) -> None:
    """At full speed, accelerated and braked at the limits, ending on the joint's limit: past it by less than 1 mrad.

    The speed is kept within 1 %. The same as a cubic without room to brake, as it was accepted once, is refused.
    """
    robot = shipped.robot
    ramp = robot.max_velocity[joint] / shipped.controller.max_acceleration[joint]
    start, end, time = to_limit(shipped, joint, sign, ramp * (1.0 + 1e-9))
    points = TrajectoryPoints.create(robot.joint_names, robot.joint_names, [0.0, time], [start, end], [], [])
    states = simulate(shipped, points, duration=time + 0.3).slow.joint_states
    assert (robot.lower - 1e-3 < states[:, 0]).all()
    assert (states[:, 0] < robot.upper + 1e-3).all()
    assert (np.abs(states[:, 1]) < 1.01 * robot.max_velocity).all()
    assert np.abs(states[:, 1, joint]).max() > 0.99 * robot.max_velocity[joint]
    # 1000 rad/s^2, within the limits of position and speed.
    start, end, time = to_limit(shipped, joint, sign, 1e-3 * robot.max_velocity[joint])
    speed = (end - start) / (time - 1e-3 * robot.max_velocity[joint])
    ends = start + speed * 0.5e-3 * robot.max_velocity[joint], end - speed * 0.5e-3 * robot.max_velocity[joint]
    times = [0.0, 1e-3 * robot.max_velocity[joint], time - 1e-3 * robot.max_velocity[joint], time]
    sudden = TrajectoryPoints.create(
        robot.joint_names, robot.joint_names, times, [start, *ends, end], [REST, speed, speed, REST], [[]] * 4
    )
    with pytest.raises(
        TrajectoryError, match=rf"{robot.joint_names[joint]} gets a set-point acceleration -?1000 rad/s"
    ):
        simulate(shipped, sudden)
    if joint == 1:
        free = dataclasses.replace(shipped.controller, max_acceleration=np.full(6, 2e3), following_error=np.ones(6))
        past = simulate(dataclasses.replace(shipped, controller=free), sudden, duration=time + 0.3).slow.joint_states
        assert (past[:, 0] > robot.upper + 5e-3).any() or (past[:, 0] < robot.lower - 5e-3).any()
