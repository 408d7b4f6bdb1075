"""Plots of a recorded run of a line."""

from __future__ import annotations

from bokeh.models import DataRange1d
from bokeh.plotting import figure

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.style import COLOURS, INK
from rx90_emulator.loop.line import PathAccuracy


def path_error(recorded: PathAccuracy, without: PathAccuracy, name: str, limit: float) -> figure:
    """Show the path error along the line as recorded, the one of a run called `name`, and a limit, m."""
    shown = chart(
        "", "distance along the line, mm", "path error, mm", y_range=DataRange1d(start=0.0)
    )
    shown.line(without.along * 1e3, without.perpendicular * 1e3, name=name, color=COLOURS[1])
    shown.line(
        recorded.along * 1e3, recorded.perpendicular * 1e3, name="recorded", color=COLOURS[0]
    )
    shown.hspan([limit * 1e3], name="asked for laser welding", line_color=INK, line_dash="dashed")
    return shown


def tracking(joints: JointSeries, error: JointSeries) -> list[figure]:
    """Show the velocities of the joints, and their position errors."""
    velocities = chart("", "", "joint velocity, rad/s")
    errors = chart("", "", "position error, mrad")
    over_one_x([velocities, errors], "time, s")
    _draw(velocities, joints.time, joints.fields["velocity"], joints.names)
    _draw(errors, error.time, error.fields["position"] * 1e3, joints.names)
    return [velocities, errors]


def friction(elements: JointSeries) -> list[figure]:
    """Show the friction torques against time, and against velocity."""
    states = elements.fields
    over_time = chart("", "time, s", "friction torque, Nm")
    over_velocity = chart("", "input velocity, rad/s", "friction torque, Nm")
    _draw(over_time, elements.time, states["effort"], elements.names)
    for k, name in enumerate(elements.names):
        over_velocity.line(
            states["velocity"][:, k], states["effort"][:, k], name=name, color=COLOURS[k]
        )
    return [over_time, over_velocity]


def _draw(shown: figure, time: Array, values: Array, names: tuple[str, ...]) -> None:
    """Draw the columns of values, (n, k), over time, (n,)."""
    for k, name in enumerate(names):
        shown.line(time, values[:, k], name=name, color=COLOURS[k])
