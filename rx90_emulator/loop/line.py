"""Plan a line or another path, run it through the closed loop, and measure how well the tip keeps to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, check_type
from rx90_common.description.kinematics import Pose, forward
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import length, product, transposed
from rx90_controller.lines import plan as planning
from rx90_controller.lines.plan import LinePlan
from rx90_controller.lines.task import LineTask, TipTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
class PathAccuracy:
    """How far the tip strays from its path, from its start until it has settled at its end.

    Attributes:
        times: s, shape (n,).
        along: distance from the path's start, measured along it, m, shape (n,).
        perpendicular: distance from the path, m, shape (n,).
        along_track: how far ahead of its set-point the tip is along the path, m, shape (n,); negative behind it. None
            where it was not looked for, as the next one.
        orientation: angle between the tool and what the path asks for in that place, rad, shape (n,); of an arm of five
            joints that of the tool's axis.
    """

    times: Array
    along: Array
    perpendicular: Array
    along_track: Array | None = None
    orientation: Array | None = None

    @property
    def worst(self) -> float:
        """Return the largest distance from the path, m."""
        return float(self.perpendicular.max())

    @property
    def rms(self) -> float:
        """Return the root mean square distance from the path, m."""
        return math.sqrt(float(np.mean(self.perpendicular**2)))

    @property
    def worst_along_track(self) -> float:
        """Return the largest distance from the set-point along the path, m; NaN where it was not looked for."""
        return math.nan if self.along_track is None else float(np.abs(self.along_track).max())

    @property
    def worst_orientation(self) -> float:
        """Return the largest angle of the tool from its orientation, rad; NaN where it was not looked for."""
        return math.nan if self.orientation is None else float(self.orientation.max())


@dataclass(frozen=True, eq=False)
class LineRun(RunResult):
    """A run of the closed loop along a line, or another path.

    Attributes:
        task: the line or path, as it was travelled.
        start_time: when its trajectory started, s.
    """

    task: TipTask
    start_time: float

    @cached_property
    def path_accuracy(self) -> PathAccuracy:
        """Return how far the tip strayed from its path."""
        position = self.slow.joint_states[:, 0]
        return path_accuracy(self.setup.robot, self.task, self.times, position, self.start_time)


def plan_line(setup: Setup, task: LineTask) -> LinePlan:
    """Plan a line for the arm of a setup and the rate of its set-points.

    Raises:
        LineError: saying where on the line the arm cannot go and why.
    """
    check_type(setup=(setup, Setup), task=(task, LineTask))
    return plan_path(setup, task)


def plan_path(setup: Setup, path: TipTask) -> LinePlan:
    """Plan a path, or a line, for the arm of a setup and the rate of its set-points.

    Where a joint's speed or acceleration would exceed its limit, a path is travelled more slowly; the plan's `task`
    says so in its `remarks`.

    Raises:
        LineError: saying where on the path the arm cannot go and why.
    """
    check_type(setup=(setup, Setup), path=(path, LineTask if isinstance(path, LineTask) else Path))
    limits = setup.controller.limits(setup.robot)
    return planning.plan_line(setup.robot, path, setup.rates.position_period, limits.acceleration)


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
    check_type(setup=(setup, Setup), task=(task, LineTask))
    return run_path(
        setup, task, start_time=start_time, substeps=substeps, record_fast=record_fast, correction=correction
    )


def run_path(
    setup: Setup,
    path: TipTask,
    *,
    start_time: float = 0.0,
    substeps: int | None = None,
    record_fast: bool = False,
    correction: Correction | None = None,
) -> LineRun:
    """Plan a path, or a line, and run it as `run_line` says.

    Raises:
        TrajectoryError: if the correction is refused.
        LineError: if the arm cannot travel the path.
        DivergenceError: naming joint and tick.
    """
    plan = plan_path(setup, path)
    points = replace(plan.points, correction=correction)
    run = simulate(setup, points, start_time=start_time, substeps=substeps, record_fast=record_fast)
    task = path if isinstance(path, LineTask) else plan.task
    return LineRun(run.setup, run.fast, run.slow, run.saturated, run.commands, run.substeps, task, start_time)


def path_accuracy(
    robot: RobotModel, task: TipTask, times: Array, joint_position: Array, start_time: float = 0.0
) -> PathAccuracy:
    """Measure the path error of joint positions, rad, shape (n, joints), at `times`, s, shape (n,).

    Args:
        robot: the arm.
        task: the line; the path as it was planned, `plan.task` (joints may have asked for lower speeds).
        times: s.
        joint_position: rad.
        start_time: when the trajectory starts, that is the rest before the path, s.

    Raises:
        ConfigError: if the shapes do not fit together, or a joint position on the path is not finite.
    """
    times, joint_position = np.asarray(times, dtype=np.float64), np.asarray(joint_position, dtype=np.float64)
    shape = (times.size, len(robot.joint_names))
    if times.ndim != 1 or joint_position.shape != shape:
        raise ConfigError(f"joint positions: shape {joint_position.shape}; accepted: {shape}, a row for each time")
    begin, end = task.counted
    window = (times >= start_time + begin) & (times <= start_time + end)
    if not np.isfinite(joint_position[window]).all():
        raise ConfigError(f"a joint position on the {task.what} is not finite; accepted: finite numbers")
    pose = forward(robot.chain, joint_position[window])
    asked = task.profile().sample(times[window] - start_time - begin).distance
    error = task.error(pose.position, asked)
    turned = _turned(robot, pose, task.poses(np.clip(error.along, 0.0, task.length)))
    return PathAccuracy(times[window], error.along, error.perpendicular, error.along - asked, turned)


def _turned(robot: RobotModel, pose: Pose, asked: Pose) -> Array:
    """Return the angle between poses, rad, shape (n,)."""
    if len(robot.joint_names) < 6:  # the arm turns its tool about the tool's axis as it likes
        first, second = pose.rotation[..., 2], asked.rotation[..., 2]
        cosine = np.sum(first * second, axis=-1)
        return np.asarray(np.arctan2(length(np.cross(first, second)), cosine))
    turn = product(transposed(asked.rotation), pose.rotation)
    skew = 0.5 * np.stack([turn[..., i, j] - turn[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    return np.asarray(np.arctan2(length(skew), 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)))
