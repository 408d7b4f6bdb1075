"""The report's plots."""

from __future__ import annotations

from rx90_common.report.plot import COLOURS, INK, Curve, Level, Panel, Plot
from rx90_emulator.demo.analysis import SWITCHED_OFF, RunAnalysis, field


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
