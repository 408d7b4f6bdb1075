"""Run a Cartesian line through the closed loop and measure how well the tip keeps to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90_common.description.kinematics import forward, path_error
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.plan import LinePlan, plan_line
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import RunResult, simulate
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]

SETTLING = 0.2
"""How long after its end a line still counts for the path error, s: there the arm comes to rest."""


@dataclass(frozen=True)
class PathAccuracy:
    """How far the tip strays from the line, from its start until it has settled at its end.

    Attributes:
        times: s, shape (n,).
        along: distance from the line's start, measured along it, m, shape (n,).
        perpendicular: distance from the line, m, shape (n,).
    """

    times: Array
    along: Array
    perpendicular: Array

    @property
    def worst(self) -> float:
        """Return the largest distance from the line, m."""
        return float(self.perpendicular.max())

    @property
    def rms(self) -> float:
        """Return the root mean square distance from the line, m."""
        return math.sqrt(float(np.mean(self.perpendicular**2)))


def line_points(plan: LinePlan) -> TrajectoryPoints:
    """Return a planned line as the points that the controller takes."""
    return TrajectoryPoints.create(
        plan.joint_names,
        plan.joint_names,
        plan.times.tolist(),
        plan.position.tolist(),
        plan.velocity.tolist(),
        plan.acceleration.tolist(),
    )


def run_task(
    setup: Setup, task: LineTask, *, start_time: float = 0.0, substeps: int = 1, record_fast: bool = False
) -> RunResult:
    """Plan the line, put the arm at rest at its beginning, and run it from `start_time`, s, to its end.

    Raises:
        LineError: if the arm cannot travel the line.
        DivergenceError: naming joint and tick.
    """
    plan = plan_line(setup.robot, task, setup.rates.position_period)
    return simulate(
        setup,
        line_points(plan),
        plan.start_pose,
        start_time + plan.duration,
        start_time=start_time,
        substeps=substeps,
        record_fast=record_fast,
    )


def path_accuracy(
    robot: RobotModel, task: LineTask, times: Array, joint_position: Array, start_time: float = 0.0
) -> PathAccuracy:
    """Measure the path error of joint positions, rad, shape (n, 6), at `times`, s, shape (n,).

    The trajectory, that is the rest before the line, starts at `start_time`, s.
    """
    begin = start_time + task.rest_before
    end = begin + task.profile().duration + min(SETTLING, task.rest_after)
    window = (times >= begin) & (times <= end)
    tip = forward(robot.chain, joint_position[window]).position
    error = path_error(tip, np.array(task.start), np.array(task.end))
    return PathAccuracy(times[window], error.along, error.perpendicular)
