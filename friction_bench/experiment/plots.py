"""The report's plots, as SVG text, after the source's figures 4 to 8."""

from __future__ import annotations

from typing import Any

import numpy as np

from friction_bench.experiment.evaluation import RampTestResult
from friction_bench.experiment.four_way import EXPERIMENT, FourWay, measured_velocity
from friction_bench.experiment.identification import SAME_SLOPE, RampIdentification, slopes_of
from rx90_common.report.drawing import COLOURS, as_svg, make_figure

_FIT: Any = {"color": "black", "linestyle": "--", "linewidth": 0.9}


def velocity_plot(part: RampIdentification) -> str:
    """Draw the velocities of all repeats with what was fitted, one panel a slope (figures 4 to 6)."""
    slopes = slopes_of(part.ramps)
    figure, panels = make_figure(len(slopes) + 1, 3.0 + 2.2 * len(slopes), share_x=False)
    for j, (axes, slope) in enumerate(zip(panels, slopes, strict=False)):
        ramps = [ramp for ramp in part.ramps if abs(ramp.slope - slope) <= SAME_SLOPE * slope]
        for k, ramp in enumerate(ramps):
            time, velocity = measured_velocity(ramp.record)
            axes.plot(time, velocity, color=COLOURS[k % len(COLOURS)], linewidth=0.7, alpha=0.8)
            axes.plot(ramp.time, ramp.velocity, **_FIT)
            fitted = (time >= ramp.time[0]) & (time <= ramp.time[-1])
            deviation = velocity[fitted] - np.interp(time[fitted], ramp.time, ramp.velocity)
            panels[-1].plot(time[fitted], deviation, color=COLOURS[j % len(COLOURS)], linewidth=0.6, alpha=0.7)
            axes.axvline(ramp.break_away, color=COLOURS[k % len(COLOURS)], linewidth=0.5, linestyle=":")
        axes.set_xlabel("time since the torque's zero, s")
        axes.set_ylabel("motor velocity, rad/s")
        axes.set_title(
            f"m = {slope:.4g} Nm/s, {len(ramps)} {'ramp' if len(ramps) == 1 else 'repeats'}", fontsize=9, loc="left"
        )
    panels[0].plot([], [], label="fitted velocity", **_FIT)
    panels[0].plot([], [], color="grey", linestyle=":", linewidth=0.8, label="break-away")
    panels[0].legend(frameon=False, loc="upper left")
    panels[-1].set(xlabel="time since the torque's zero, s", ylabel="less fit, rad/s")
    panels[-1].set_title("all ramps from where the shaft slides, one colour a slope", fontsize=9, loc="left")
    return as_svg(figure)


def load_plot(result: RampTestResult) -> str:
    """Draw one no-load and one loaded ramp of each slope on the same axes."""
    figure, (axes,) = make_figure(1, 3.0)
    for k, (name, part) in enumerate(result.parts):
        for j, slope in enumerate(slopes_of(part.ramps)):
            ramp = min(part.ramps, key=lambda r: abs(r.slope - slope))
            time, velocity = measured_velocity(ramp.record)
            torque = time * ramp.slope
            style = ("-", "--", ":", "-.")[j % 4]
            label = f"{name}, {slope:.3g} Nm/s"
            axes.plot(torque, velocity, color=COLOURS[k], linewidth=1.0, linestyle=style, label=label)
    axes.set(xlabel="motor torque m t, Nm", ylabel="motor velocity, rad/s")
    axes.legend(frameon=False)
    return as_svg(figure)


def comparison_plot(comparison: FourWay) -> str:
    """Draw the four velocities and their differences from the closed form (figures 7 and 8)."""
    figure, (upper, lower) = make_figure(2, 4.6)
    *_, closed = comparison.velocities.values()
    for k, (name, velocity) in enumerate(comparison.velocities.items()):
        style = ("-", "--", ":", "-.")[k]
        width = 0.8 if name == EXPERIMENT else 1.4
        upper.plot(comparison.time, velocity, color=COLOURS[k], linestyle=style, linewidth=width, label=name)
        share = 100 * (velocity - closed) / closed[-1]
        lower.plot(comparison.time, share, color=COLOURS[k], linestyle=style, linewidth=width)
    upper.set_ylabel("motor velocity, rad/s")
    upper.legend(frameon=False)
    lower.set(xlabel="time since the torque's zero, s", ylabel="less closed form, %")
    return as_svg(figure)
