"""Plan a Cartesian line, run it through the closed loop, and measure how well the tip keeps to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, check_type
from rx90_common.description.kinematics import forward, path_error
from rx90_common.description.robot import RobotModel
from rx90_controller.lines import plan as planning
from rx90_controller.lines.plan import LinePlan
from rx90_controller.lines.task import LineTask
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
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


@dataclass(frozen=True, eq=False)
class LineRun(RunResult):
    """A run of the closed loop along a line.

    Attributes:
        task: the line.
        start_time: when its trajectory started, s.
    """

    task: LineTask
    start_time: float

    @cached_property
    def path_accuracy(self) -> PathAccuracy:
        """Return how far the tip strayed from the line."""
        position = self.slow.joint_states[:, 0]
        return path_accuracy(self.setup.robot, self.task, self.times, position, self.start_time)


def plan_line(setup: Setup, task: LineTask) -> LinePlan:
    """Plan a line for the arm of a setup and the rate of its set-points.

    Raises:
        LineError: saying where on the line the arm cannot go and why.
    """
    check_type(setup=(setup, Setup), task=(task, LineTask))
    return planning.plan_line(setup.robot, task, setup.rates.position_period)


def run_line(
    setup: Setup,
    task: LineTask,
    *,
    start_time: float = 0.0,
    substeps: int | None = None,
    record_fast: bool = False,
    correction: Correction | None = None,
) -> LineRun:
    """Plan a line, put the arm at rest at its beginning, and run it through the closed loop to its end.

    Args:
        setup: robot, drives, friction, controller, rates.
        task: the line.
        start_time: when the trajectory, that is the rest before the line, starts, s.
        substeps: plant steps in a tick; None for as many as the arm needs, usually 1.
        record_fast: also keep the series on base ticks.
        correction: offsets of the position set-points, as `learn_correction` finds them.

    Raises:
        TrajectoryError: if the correction is refused.
        LineError: if the arm cannot travel the line.
        DivergenceError: naming joint and tick.
    """
    points = replace(plan_line(setup, task).points, correction=correction)
    run = simulate(setup, points, start_time=start_time, substeps=substeps, record_fast=record_fast)
    return LineRun(run.setup, run.fast, run.slow, run.saturated, run.commands, run.substeps, task, start_time)


def path_accuracy(
    robot: RobotModel, task: LineTask, times: Array, joint_position: Array, start_time: float = 0.0
) -> PathAccuracy:
    """Measure the path error of joint positions, rad, shape (n, 6), at `times`, s, shape (n,).

    The trajectory, that is the rest before the line, starts at `start_time`, s.

    Raises:
        ConfigError: if the shapes do not fit together, or a joint position on the line is not finite.
    """
    times, joint_position = np.asarray(times, dtype=np.float64), np.asarray(joint_position, dtype=np.float64)
    shape = (times.size, len(robot.joint_names))
    if times.ndim != 1 or joint_position.shape != shape:
        raise ConfigError(f"joint positions: shape {joint_position.shape}; accepted: {shape}, a row for each time")
    begin, end = task.counted
    window = (times >= start_time + begin) & (times <= start_time + end)
    if not np.isfinite(joint_position[window]).all():
        raise ConfigError("a joint position on the line is not finite; accepted: finite numbers")
    tip = forward(robot.chain, joint_position[window]).position
    error = path_error(tip, np.array(task.start), np.array(task.end))
    return PathAccuracy(times[window], error.along, error.perpendicular)
