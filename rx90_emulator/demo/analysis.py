"""What the report shows of a recorded run, as arrays and numbers; no drawing, no ROS."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.arrays import Array
from rx90_controller.law.parameters import FeedForward
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.line import PathAccuracy, path_accuracy, run_line
from rx90_emulator.loop.setup import Setup

SWITCHED_OFF = "FF and dq_r off"
"""What the recorded run is compared with, by the name that it has in docs/explanation/models.md."""


@dataclass(frozen=True)
class RunAnalysis:
    """A recorded run of a line.

    Attributes:
        joints: the bag's joint_states.
        friction: the bag's friction_states.
        error: the bag's tracking_error.
        path: path error of the recorded run.
        path_without: path error of the same task with FF and dq_r off, computed without ROS.
    """

    joints: JointSeries
    friction: JointSeries
    error: JointSeries
    path: PathAccuracy
    path_without: PathAccuracy


def analyse(bag: Path, setup: Setup, task: LineTask, start_time: float) -> RunAnalysis:
    """Read a recorded run, whose trajectory started at `start_time` s, and compute what the report shows.

    Raises:
        BagError: if a topic is missing.
    """
    joints = read_joint_states(bag, "joint_states", setup.robot.joint_names)
    friction = read_joint_states(bag, "friction_states", setup.friction.names)
    error = read_joint_states(bag, "rx90_controller/tracking_error", setup.robot.joint_names)
    path = path_accuracy(setup.robot, task, joints.time, field(joints, "position"), start_time)
    return RunAnalysis(joints, friction, error, path, _path_switched_off(setup, task))


def field(series: JointSeries, name: str) -> Array:
    """Return one array of a series, which the suite's topics always carry."""
    return series.fields[name]


def _path_switched_off(setup: Setup, task: LineTask) -> PathAccuracy:
    controller = dataclasses.replace(setup.controller, feed_forward=FeedForward.off())
    return run_line(dataclasses.replace(setup, controller=controller), task).path_accuracy
