"""Plots of a ramp test."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from bokeh.plotting import figure

from friction_bench.experiment.four_way import EXPERIMENT, FourWay, measured_velocity
from friction_bench.experiment.identification import RampIdentification, slopes_of
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.style import COLOURS, GREY, INK

_DASHES = ("solid", "dashed", "dotted", "dashdot")
_TIME = "time since the torque's zero, s"


def velocities(part: RampIdentification) -> list[figure]:
    """Show the velocities of all repeats with the fitted ones, a figure for each slope (figures 4 to 6)."""
    figures = []
    deviations = chart(
        "all ramps from where the shaft slides, one colour a slope", _TIME, "less fit, rad/s"
    )
    for j, slope in enumerate(slopes_of(part.ramps)):
        ramps = [ramp for ramp in part.ramps if ramp.slope == slope]
        title = f"m = {slope:.4g} Nm/s, {len(ramps)} {'ramp' if len(ramps) == 1 else 'repeats'}"
        shown = chart(title, _TIME, "motor velocity, rad/s")
        for k, ramp in enumerate(ramps):
            time, velocity = measured_velocity(ramp.record)
            shown.line(time, velocity, color=COLOURS[k % len(COLOURS)])
            shown.vspan([ramp.break_away], name="break-away", line_color=GREY, line_dash="dotted")
            fitted = (time >= ramp.time[0]) & (time <= ramp.time[-1])
            deviation = velocity[fitted] - np.interp(time[fitted], ramp.time, ramp.velocity)
            deviations.line(time[fitted], deviation, color=COLOURS[j % len(COLOURS)])
        for ramp in ramps:
            shown.line(
                ramp.time, ramp.velocity, name="fitted velocity", color=INK, line_dash="dashed"
            )
        figures.append(shown)
    return [*figures, deviations]


def loads(parts: Mapping[str, RampIdentification]) -> figure:
    """Show a ramp of each load, by its name, and slope on the same axes."""
    shown = chart("", "motor torque m t, Nm", "motor velocity, rad/s", height=240)
    for k, (name, part) in enumerate(parts.items()):
        for j, slope in enumerate(slopes_of(part.ramps)):
            ramp = next(ramp for ramp in part.ramps if ramp.slope == slope)
            time, velocity = measured_velocity(ramp.record)
            shown.line(
                time * ramp.slope,
                velocity,
                name=f"{name}, {slope:.3g} Nm/s",
                color=COLOURS[k],
                line_dash=_DASHES[j % len(_DASHES)],
            )
    return shown


def four_ways(comparison: FourWay) -> list[figure]:
    """Show the four velocities and their differences from the closed form (figures 7 and 8)."""
    above = chart("", "", "motor velocity, rad/s")
    below = chart("", "", "less closed form, %")
    over_one_x([above, below], _TIME)
    *_, closed = comparison.velocities.values()
    for k, (name, velocity) in enumerate(comparison.velocities.items()):
        width = 1.0 if name == EXPERIMENT else 1.8
        difference = 100 * (velocity - closed) / closed[-1]
        for shown, values in ((above, velocity), (below, difference)):
            shown.line(
                comparison.time,
                values,
                name=name,
                color=COLOURS[k],
                line_width=width,
                line_dash=_DASHES[k],
            )
    return [above, below]


def source_input(comparison: FourWay) -> list[figure]:
    """Show the models under the source's own input: velocities, and the other outputs of the block diagram's sensor."""
    sensor = comparison.as_source
    velocity = chart("velocity", "time, s", "motor velocity, rad/s")
    for k, (name, values) in enumerate(comparison.source_velocities.items()):
        velocity.line(
            sensor.time,
            values,
            name=name,
            color=COLOURS[k + 1],
            line_width=1.8,
            line_dash=_DASHES[k],
        )
    figures = [velocity]
    for title, values, unit in (
        ("position", sensor.position, "rad"),
        ("acceleration", sensor.acceleration, "rad/s²"),
        ("reaction torque", sensor.reaction, "Nm"),
    ):
        shown = chart(title, "time, s", unit)
        shown.line(sensor.time, values, name="block diagram", color=COLOURS[1])
        figures.append(shown)
    return figures
