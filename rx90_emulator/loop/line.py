"""Plan a line or another path, run it through the closed loop, and measure how well the tip keeps to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array, Mask, interpolated, rms
from rx90_common.base.errors import ConfigError, check_type
from rx90_common.description.kinematics import Pose, forward, polyline_error, tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import angle_between, length, product, transposed
from rx90_controller.lines import plan as planning
from rx90_controller.lines.plan import LinePlan
from rx90_controller.lines.task import SETTLING, LineTask, TipTask
from rx90_controller.paths.path import Path
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.result import MotionCommand, RunResult
from rx90_emulator.loop.setup import Setup

_AT_REST = 1e-4  # m/s: slower set-points have no direction of their own but for rounding
_START_ZONE = 0.01  # m
_SHORTEST_REST = 0.1  # s: in shorter stops the tip is at a corner of one path, and may cut it
_ROUNDING = 1e-9  # s, of stamps


@dataclass(frozen=True, eq=False)
class PathAccuracy:
    """How far the tip strays from its path, from its start until it has settled at its end.

    Attributes:
        times: s, shape (n,).
        along: distance from the path's start, measured along it, m, shape (n,).
        perpendicular: distance from the path, m, shape (n,).
        along_track: how far ahead of its set-point the tip is along the path, m, shape (n,); negative behind it. NaN
            where it is not known.
        orientation: angle between the tool and what the path asks for in that place, rad, shape (n,); of an arm of five
            joints that of the tool's axis.
    """

    times: Array
    along: Array
    perpendicular: Array
    along_track: Array
    orientation: Array

    def take(self, rows: Mask) -> PathAccuracy:
        """Return those of some of the times."""
        return PathAccuracy(**{name: values[rows] for name, values in vars(self).items()})

    @property
    def worst(self) -> float:
        """Return the largest distance from the path, m; 0 where nothing counts."""
        return float(self.perpendicular.max(initial=0.0))

    @property
    def rms(self) -> float:
        """Return the root mean square distance from the path, m."""
        return rms(self.perpendicular)

    @property
    def worst_along_track(self) -> float:
        """Return the largest distance from the set-point along the path, m; NaN where it is not known."""
        return float(np.abs(self.along_track).max(initial=0.0))

    @property
    def worst_orientation(self) -> float:
        """Return the largest angle of the tool from its orientation, rad."""
        return float(self.orientation.max(initial=0.0))

    def beyond_start(self, digits: int) -> str:
        """Return in words the largest distance beyond the path's first 10 mm, m, if the largest of all is in these.

        There a motion that follows another one bends the bristles back.
        """
        beyond = self.perpendicular[self.along > _START_ZONE]
        if not beyond.size or beyond.max() == self.worst:
            return ""
        return f" (beyond {1e3 * _START_ZONE:.0f} mm: {1e3 * beyond.max():.{digits}f} mm)"

    @property
    def words(self) -> str:
        """Return the largest errors in words."""
        if not len(self.times):
            return "no path error: set-points that do not move the tip"
        return (
            f"path error {1e3 * self.worst:.4f} mm{self.beyond_start(4)}, RMS {1e3 * self.rms:.4f} mm; along the path "
            f"{1e3 * self.worst_along_track:.4f} mm; tool {1e3 * self.worst_orientation:.4f} mrad"
        )


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
    record_fast: bool = False,
    correction: Correction | None = None,
) -> LineRun:
    """Plan a line, put the arm at rest at its beginning, and run it through the closed loop to its end.

    Args:
        setup: robot, drives, friction, controller, rates.
        task: the line.
        start_time: when the trajectory, that is the rest before the line, starts, s.
        record_fast: also keep the series on base ticks.
        correction: offsets of the position set-points, as `learn_correction` finds them.

    Raises:
        ConfigError: if the correction was learned on another robot or motion.
        TrajectoryError: if the correction is refused.
        LineError: if the arm cannot travel the line.
        DivergenceError: naming joint and tick.
    """
    check_type(setup=(setup, Setup), task=(task, LineTask))
    return run_path(
        setup,
        task,
        start_time=start_time,
        record_fast=record_fast,
        correction=correction,
    )


def run_path(
    setup: Setup,
    path: TipTask,
    *,
    start_time: float = 0.0,
    record_fast: bool = False,
    correction: Correction | None = None,
) -> LineRun:
    """Plan a path, or a line, and run it as `run_line` says.

    Raises:
        ConfigError: if the correction was learned on another robot or motion.
        TrajectoryError: if the correction is refused.
        LineError: if the arm cannot travel the path.
        DivergenceError: naming joint and tick.
    """
    plan = plan_path(setup, path)
    points = plan.points
    command = MotionCommand(setup.rates.start_tick(start_time), points, correction)
    end = start_time + float(points.times[-1])
    run = simulate_commands(setup, (command,), points.position[0], end, record_fast=record_fast)
    task = path if isinstance(path, LineTask) else plan.task
    return LineRun(**vars(run), task=task, start_time=start_time)


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
    times = np.asarray(times, dtype=np.float64)
    joint_position = np.asarray(joint_position, dtype=np.float64)
    shape = (times.size, len(robot.joint_names))
    if times.ndim != 1 or joint_position.shape != shape:
        raise ConfigError(
            f"joint positions: shape {joint_position.shape}; accepted: {shape}, a row for each time"
        )
    begin, end = task.counted
    window = (times >= start_time + begin) & (times <= start_time + end)
    if not np.isfinite(joint_position[window]).all():
        raise ConfigError(
            f"a joint position on the {task.what} is not finite; accepted: finite numbers"
        )
    pose = forward(robot.chain, joint_position[window])
    asked = task.profile().sample(times[window] - start_time - begin).distance
    error = task.error(pose.position, asked)
    turned = turned_by(robot, pose, task.poses(np.clip(error.along, 0.0, task.length)))
    return PathAccuracy(
        times[window], error.along, error.perpendicular, error.along - asked, turned
    )


def followed_accuracy(
    robot: RobotModel, times: Array, joint_position: Array, setpoint_times: Array, setpoints: Array
) -> PathAccuracy:
    """Measure the path error of joint positions against the path that their set-points describe, whatever it is.

    What set-points do between two rests is a path by itself, and counts as `TipTask.counted` says; `times` of the
    result are those that count, none if the set-points never move. Places on it are those of the set-points, between
    which the tip goes straight.

    Args:
        robot: the arm.
        times: s, increasing, shape (n,).
        joint_position: rad, shape (n, joints), finite.
        setpoint_times: s, increasing, shape (m,).
        setpoints: rad, shape (m, joints), finite.
    """
    tips = tip_position(robot.chain, setpoints)
    steps = np.flatnonzero(length(np.diff(tips, axis=0)) > _AT_REST * np.diff(setpoint_times))
    rests = (
        np.flatnonzero(setpoint_times[steps[1:]] - setpoint_times[steps[:-1] + 1] > _SHORTEST_REST)
        + 1
    )
    found = [np.empty((5, 0))]
    for moves in np.split(steps, rests) if len(steps) else []:
        places = np.append(moves[0], moves + 1)
        begin, end = setpoint_times[places[[0, -1]]]
        rows = slice(*np.searchsorted(times, [begin, end + SETTLING + _ROUNDING]))
        if len(steps) > (after := np.searchsorted(steps, moves[-1], side="right")):
            rows = slice(
                rows.start,
                min(rows.stop, int(np.searchsorted(times, setpoint_times[steps[after]]))),
            )
        corners = tips[places]
        when = setpoint_times[places]
        pose = forward(robot.chain, joint_position[rows])
        near = np.clip(np.searchsorted(when, times[rows], side="right") - 1, 0, len(when) - 1)
        along, across = polyline_error(pose.position, corners, near)
        way = np.append(0.0, np.cumsum(length(np.diff(corners, axis=0))))
        there = interpolated(along, way, setpoints[places])
        turned = turned_by(robot, pose, forward(robot.chain, there))
        found.append(
            np.stack(
                [times[rows], along, across, along - np.interp(times[rows], when, way), turned]
            )
        )
    return PathAccuracy(*np.concatenate(found, axis=1))


def turned_by(robot: RobotModel, pose: Pose, asked: Pose) -> Array:
    """Return the angle between poses of the tool, rad, shape (n,); of an arm of five joints that of its axis."""
    if len(robot.joint_names) < 6:  # the arm turns its tool about the tool's axis as it likes
        return angle_between(pose.rotation[..., 2], asked.rotation[..., 2])
    turn = product(transposed(asked.rotation), pose.rotation)
    skew = 0.5 * np.stack(
        [turn[..., i, j] - turn[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1
    )
    return np.asarray(np.arctan2(length(skew), 0.5 * (np.trace(turn, axis1=-2, axis2=-1) - 1.0)))
