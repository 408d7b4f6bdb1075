"""The report's plots, as SVG text."""

from __future__ import annotations

from rx90_common.report.drawing import COLOURS, as_svg, make_figure
from rx90_emulator.demo.analysis import RunAnalysis, field


def path_error_plot(run: RunAnalysis, limit: float) -> str:
    """Draw the path error along the line, with and without feed-forward; `limit` in m."""
    figure, (axes,) = make_figure(1, height=2.8)
    for path, label, colour in (
        (run.path_without, "without feed-forward", COLOURS[1]),
        (run.path, "with feed-forward (recorded)", COLOURS[0]),
    ):
        axes.plot(path.along * 1e3, path.perpendicular * 1e3, color=colour, label=label, linewidth=1.2)
    axes.axhline(limit * 1e3, color="black", linestyle="--", linewidth=0.8, label="asked for laser welding")
    axes.set(xlabel="distance along the line, mm", ylabel="path error, mm")
    axes.set_ylim(bottom=0.0)
    axes.legend(ncol=3, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return as_svg(figure)


def tracking_plot(run: RunAnalysis) -> str:
    """Draw joint velocities and position errors against time."""
    figure, (upper, lower) = make_figure(2, height=4.6)
    for k, name in enumerate(run.joints.names):
        upper.plot(run.joints.time, field(run.joints, "velocity")[:, k], color=COLOURS[k], label=name, linewidth=1)
        lower.plot(run.error.time, field(run.error, "position")[:, k] * 1e3, color=COLOURS[k], linewidth=0.8)
    upper.set(ylabel="joint velocity, rad/s")
    lower.set(xlabel="time, s", ylabel="position error, mrad")
    upper.legend(ncol=6, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
    return as_svg(figure)


def friction_plot(run: RunAnalysis) -> str:
    """Draw the seven friction torques against time, and against velocity."""
    figure, (upper, lower) = make_figure(2, height=5.0, share_x=False)
    for k, name in enumerate(run.friction.names):
        torque, velocity = field(run.friction, "effort")[:, k], field(run.friction, "velocity")[:, k]
        upper.plot(run.friction.time, torque, color=COLOURS[k], label=name, linewidth=1)
        lower.plot(velocity, torque, color=COLOURS[k], linewidth=0.8)
    upper.set(xlabel="time, s", ylabel="friction torque, Nm")
    lower.set(xlabel="input velocity, rad/s", ylabel="friction torque, Nm")
    upper.legend(ncol=7, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.0)
    return as_svg(figure)


def effort_plot(run: RunAnalysis) -> str:
    """Draw the drive torques at the joints against time."""
    figure, (axes,) = make_figure(1, height=2.8)
    for k, name in enumerate(run.joints.names):
        axes.plot(run.joints.time, field(run.joints, "effort")[:, k], color=COLOURS[k], label=name, linewidth=0.8)
    axes.set(xlabel="time, s", ylabel="drive torque, Nm")
    axes.legend(ncol=6, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
    return as_svg(figure)
