"""The report of a run: one self-contained HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90_common.bags.comparison import BagComparison, Verdict
from rx90_common.description.robot_files import RobotFiles, provenance_of
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, INK, Curve, Level, Panel, Plot
from rx90_controller.lines.task import LineTask
from rx90_emulator.demo.analysis import SWITCHED_OFF, RunAnalysis, field
from rx90_emulator.demo.animation import animate
from rx90_emulator.loop.setup import Setup

PATH_LIMIT = 1e-4
"""Path accuracy that laser welding asks for, m (the paper's introduction)."""


def path_error_plot(run: RunAnalysis, limit: float) -> Plot:
    """Show the path error along the line, as recorded and with FF and dq_r off; `limit` in m."""
    curves = [
        Curve(path.along * 1e3, path.perpendicular * 1e3, label, colour, 1.2)
        for path, label, colour in (
            (run.path_without, SWITCHED_OFF, COLOURS[1]),
            (run.path, "recorded", COLOURS[0]),
        )
    ]
    limit_line = Level(limit * 1e3, "asked for laser welding", INK, "dashed")
    return Plot([Panel([*curves, limit_line], "", "distance along the line, mm", "path error, mm", from_zero=True)])


def tracking_plot(run: RunAnalysis) -> Plot:
    """Show joint velocities and position errors against time."""
    velocity, error = field(run.joints, "velocity"), field(run.error, "position") * 1e3
    named = list(enumerate(run.joints.names))
    upper = [Curve(run.joints.time, velocity[:, k], name, COLOURS[k]) for k, name in named]
    lower = [Curve(run.error.time, error[:, k], name, COLOURS[k], 0.8) for k, name in named]
    panels = [Panel(upper, y_label="joint velocity, rad/s"), Panel(lower, "", "time, s", "position error, mrad")]
    return Plot(panels, share_x=True)


def friction_plot(run: RunAnalysis) -> Plot:
    """Show the seven friction torques against time, and against velocity."""
    torque, velocity = field(run.friction, "effort"), field(run.friction, "velocity")
    named = list(enumerate(run.friction.names))
    upper = [Curve(run.friction.time, torque[:, k], name, COLOURS[k]) for k, name in named]
    lower = [Curve(velocity[:, k], torque[:, k], name, COLOURS[k], 0.8) for k, name in named]
    return Plot(
        [
            Panel(upper, "", "time, s", "friction torque, Nm"),
            Panel(lower, "", "input velocity, rad/s", "friction torque, Nm"),
        ]
    )


def effort_plot(run: RunAnalysis) -> Plot:
    """Show the drive torques at the joints against time."""
    effort = field(run.joints, "effort")
    curves = [Curve(run.joints.time, effort[:, k], name, COLOURS[k], 0.8) for k, name in enumerate(run.joints.names)]
    return Plot([Panel(curves, "", "time, s", "drive torque, Nm")])


@dataclass(frozen=True)
class RunFacts:
    """How the recorded run went.

    Attributes:
        real_time_factor: simulated time over wall time.
        paced: the real-time factor that was asked for; 0 for none.
        composed: whether simulation and controller shared a process.
        messages: recorded messages by topic.
        bag: the recorded bag.
        baseline: the bag it was compared with.
    """

    real_time_factor: float
    paced: float
    composed: bool
    messages: dict[str, int]
    bag: Path
    baseline: Path


def write_report(
    path: Path, setup: Setup, task: LineTask, run: RunAnalysis, comparison: BagComparison, facts: RunFacts
) -> None:
    """Write the page.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    page = render_page(
        "rx90_emulator.demo",
        "report.html.j2",
        robot=setup.robot.model.name,
        provenance={} if setup.files is None else _provenance(setup.files),
        task=task,
        run=run,
        facts=facts,
        limit=PATH_LIMIT,
        switched_off=SWITCHED_OFF,
        top=max(PATH_LIMIT, run.path.worst),
        animation=animate(run, setup.robot, task),
        same=comparison.verdict is Verdict.SAME,
        topics=comparison.topics,
        largest=[max((v.maximum for v in topic.values), default=0.0) for topic in comparison.topics],
        joints=_joint_rows(run),
        friction=list(zip(setup.friction.names, setup.friction.elements, strict=True)),
        plots={
            "path": path_error_plot(run, PATH_LIMIT),
            "tracking": tracking_plot(run),
            "friction": friction_plot(run),
            "effort": effort_plot(run),
        },
    )
    write_text(path, page)


def _provenance(files: RobotFiles) -> dict[str, list[str]]:
    """Return what each file says of where its numbers come from, by its name."""
    return {getattr(files, role).name: said for role, said in provenance_of(files).items()}


def _joint_rows(run: RunAnalysis) -> list[tuple[str, float, float, float, float]]:
    """Return per joint: fastest rad/s, worst and RMS position error mrad, largest drive torque Nm."""
    error = field(run.error, "position")
    moving = (run.error.time >= run.path.times[0]) & (run.error.time <= run.path.times[-1])
    return [
        (
            name,
            float(np.abs(field(run.joints, "velocity")[:, k]).max()),
            float(np.abs(error[moving, k]).max()) * 1e3,
            float(np.sqrt(np.mean(error[moving, k] ** 2))) * 1e3,
            float(np.abs(field(run.joints, "effort")[:, k]).max()),
        )
        for k, name in enumerate(run.joints.names)
    ]
