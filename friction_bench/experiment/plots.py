"""The report's plots, after the source's figures 4 to 8."""

from __future__ import annotations

import numpy as np

from friction_bench.experiment.evaluation import RampTestResult
from friction_bench.experiment.four_way import EXPERIMENT, FourWay, measured_velocity
from friction_bench.experiment.identification import SAME_SLOPE, RampIdentification, slopes_of
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dash, Level, Mark, Panel, Plot

_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")
_TIME = "time since the torque's zero, s"


def velocity_plot(part: RampIdentification) -> Plot:
    """Show the velocities of all repeats with what was fitted, one panel a slope (figures 4 to 6)."""
    panels: list[Panel] = []
    deviations: list[Mark] = []
    for j, slope in enumerate(slopes_of(part.ramps)):
        ramps = [ramp for ramp in part.ramps if abs(ramp.slope - slope) <= SAME_SLOPE * slope]
        measured: list[Mark] = []
        fits: list[Mark] = []
        for k, ramp in enumerate(ramps):
            time, velocity = measured_velocity(ramp.record)
            measured.append(Curve(time, velocity, "", COLOURS[k % len(COLOURS)], 0.7))
            measured.append(Level(ramp.break_away, "break-away", GREY, "dotted", upright=True))
            fits.append(Curve(ramp.time, ramp.velocity, "fitted velocity", INK, 0.9, "dashed"))
            fitted = (time >= ramp.time[0]) & (time <= ramp.time[-1])
            deviation = velocity[fitted] - np.interp(time[fitted], ramp.time, ramp.velocity)
            deviations.append(Curve(time[fitted], deviation, "", COLOURS[j % len(COLOURS)], 0.6))
        title = f"m = {slope:.4g} Nm/s, {len(ramps)} {'ramp' if len(ramps) == 1 else 'repeats'}"
        panels.append(Panel([*measured, *fits], title, _TIME, "motor velocity, rad/s"))
    title = "all ramps from where the shaft slides, one colour a slope"
    return Plot([*panels, Panel(deviations, title, _TIME, "less fit, rad/s")])


def load_plot(result: RampTestResult) -> Plot:
    """Show one no-load and one loaded ramp of each slope on the same axes."""
    curves = []
    for k, (name, part) in enumerate(result.parts):
        for j, slope in enumerate(slopes_of(part.ramps)):
            ramp = min(part.ramps, key=lambda r: abs(r.slope - slope))
            time, velocity = measured_velocity(ramp.record)
            label = f"{name}, {slope:.3g} Nm/s"
            curves.append(Curve(time * ramp.slope, velocity, label, COLOURS[k], 1.0, _DASHES[j % 4]))
    return Plot([Panel(curves, "", "motor torque m t, Nm", "motor velocity, rad/s")], height=3.0)


def comparison_plot(comparison: FourWay) -> Plot:
    """Show the four velocities and their differences from the closed form (figures 7 and 8)."""
    upper, lower = [], []
    *_, closed = comparison.velocities.values()
    for k, (name, velocity) in enumerate(comparison.velocities.items()):
        style = COLOURS[k], 0.8 if name == EXPERIMENT else 1.4, _DASHES[k]
        upper.append(Curve(comparison.time, velocity, name, *style))
        lower.append(Curve(comparison.time, 100 * (velocity - closed) / closed[-1], name, *style))
    panels = [Panel(upper, y_label="motor velocity, rad/s"), Panel(lower, "", _TIME, "less closed form, %")]
    return Plot(panels, share_x=True)
