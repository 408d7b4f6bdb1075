"""The report of a recorded run of a line: the numbers that it shows, its plots, and one self-contained HTML page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.bags.comparison import BagComparison, Verdict
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.base.arrays import Array
from rx90_common.description.robot_files import provenance_of
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, INK, Curve, Level, Panel, Plot
from rx90_controller.law.parameters import FeedForward
from rx90_controller.lines.task import LineTask
from rx90_emulator.demo.animation import animate
from rx90_emulator.loop.line import path_accuracy, run_line
from rx90_emulator.loop.setup import Setup

SWITCHED_OFF = "FF and dq_r off"
"""What the recorded run is compared with, by the name that it has in docs/explanation/models.md."""

PATH_LIMIT = 1e-4
"""Path accuracy that laser welding asks for, m (the paper's introduction)."""


class RunReport:
    """What the report of a recorded run of a line shows.

    Args:
        bag: what was recorded.
        setup: of the run.
        task: the line.
        start_time: when its trajectory started, s.

    Attributes:
        bag, setup, task: as given.
        joints: the bag's joint_states.
        friction: the bag's friction_states.
        error: the bag's tracking_error.
        path: path error of the recorded run.
        path_without: path error of the same task with FF and dq_r off, computed without ROS.

    Raises:
        BagError: if a topic is missing.
    """

    def __init__(self, bag: Path, setup: Setup, task: LineTask, start_time: float) -> None:
        self.bag, self.setup, self.task, names = bag, setup, task, setup.robot.joint_names
        self.joints = read_joint_states(bag, "joint_states", names)
        self.friction = read_joint_states(bag, "friction_states", setup.friction.names)
        self.error = read_joint_states(bag, "rx90_controller/tracking_error", names)
        self.path = path_accuracy(setup.robot, task, self.joints.time, self.joints.fields["position"], start_time)
        controller = replace(setup.controller, feed_forward=FeedForward.off())
        self.path_without = run_line(replace(setup, controller=controller), task).path_accuracy

    def write(
        self, page: Path, baseline: Path, comparison: BagComparison, *, pace: float, reached: float, composed: bool
    ) -> None:
        """Write the page.

        Args:
            page: the file.
            baseline: the bag it was compared with.
            comparison: of the two bags.
            pace: the real-time factor that was asked for; 0 for none.
            reached: the one that was reached, simulated time over wall time.
            composed: whether simulation and controller shared a process.

        Raises:
            Rx90Error: if the file cannot be written.
        """
        setup, files = self.setup, self.setup.files
        text = render_page(
            "rx90_emulator.demo",
            "report.html.j2",
            robot=setup.robot.model.name,
            provenance={} if files is None else {getattr(files, k).name: v for k, v in provenance_of(files).items()},
            run=self,
            real_time_factor=reached,
            pace=pace,
            composed=composed,
            messages=sum(topic.count for topic in summarise(self.bag).topics),
            baseline=baseline,
            limit=PATH_LIMIT,
            switched_off=SWITCHED_OFF,
            top=max(PATH_LIMIT, self.path.worst),
            animation=animate(self.joints, self.path, setup.robot, self.task),
            same=comparison.verdict is Verdict.SAME,
            topics=comparison.topics,
            joints=_joint_rows(self),
            friction=list(zip(setup.friction.names, setup.friction.elements, strict=True)),
            plots=_plots(self),
        )
        write_text(page, text)


def _plots(run: RunReport) -> dict[str, Plot]:
    """Return path error along the line, velocities and position errors, friction, and drive torques."""
    joints, friction, names = run.joints, run.friction.fields, run.friction.names
    path = [
        Curve(path.along * 1e3, path.perpendicular * 1e3, label, colour, 1.2)
        for path, label, colour in ((run.path_without, SWITCHED_OFF, COLOURS[1]), (run.path, "recorded", COLOURS[0]))
    ]
    limit = Level(PATH_LIMIT * 1e3, "asked for laser welding", INK, "dashed")
    velocities = _curves(joints.time, joints.fields["velocity"], joints.names)
    errors = _curves(run.error.time, run.error.fields["position"] * 1e3, joints.names, 0.8)
    over_time = _curves(run.friction.time, friction["effort"], names)
    over_velocity = _curves(friction["velocity"], friction["effort"], names, 0.8)
    efforts = _curves(joints.time, joints.fields["effort"], joints.names, 0.8)
    return {
        "path": Plot([Panel([*path, limit], "", "distance along the line, mm", "path error, mm", from_zero=True)]),
        "tracking": Plot(
            [Panel(velocities, y_label="joint velocity, rad/s"), Panel(errors, "", "time, s", "position error, mrad")],
            share_x=True,
        ),
        "friction": Plot(
            [
                Panel(over_time, "", "time, s", "friction torque, Nm"),
                Panel(over_velocity, "", "input velocity, rad/s", "friction torque, Nm"),
            ]
        ),
        "effort": Plot([Panel(efforts, "", "time, s", "drive torque, Nm")]),
    }


def _curves(x: Array, y: Array, names: tuple[str, ...], width: float = Curve.width) -> list[Curve]:
    """Return the curves of the columns of `y`, (n, k), over `x`, (n,) or (n, k)."""
    return [Curve(x if x.ndim == 1 else x[:, k], y[:, k], name, COLOURS[k], width) for k, name in enumerate(names)]


def _joint_rows(run: RunReport) -> list[tuple[str, float, float, float, float]]:
    """Return per joint: fastest rad/s, worst and RMS position error mrad, largest drive torque Nm."""
    moving = (run.error.time >= run.path.times[0]) & (run.error.time <= run.path.times[-1])
    error = run.error.fields["position"][moving]
    columns = (
        np.abs(run.joints.fields["velocity"]).max(axis=0),
        np.abs(error).max(axis=0) * 1e3,
        np.sqrt(np.mean(error**2, axis=0)) * 1e3,
        np.abs(run.joints.fields["effort"]).max(axis=0),
    )
    return list(zip(run.joints.names, *(column.tolist() for column in columns), strict=True))
