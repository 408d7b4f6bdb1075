"""The result of a measurement: on the terminal, as an HTML page, and as YAML that rx90_sim reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from friction_bench.experiment.four_way import (
    EXPERIMENT,
    FIXED_STEP,
    SETTLED,
    SMOOTHING,
    SOURCE_SLOPE,
    SOURCE_START,
    STICTION,
    FourWay,
    Pair,
    measured_velocity,
)
from friction_bench.experiment.identification import (
    SLOPE_TOLERANCE,
    SOURCE_STATES,
    IntervalEstimate,
    RampFriction,
    RampIdentification,
    RampTestResult,
    SourceEvaluation,
    slopes_of,
)
from friction_bench.rig.rig_file import Rig
from rx90_common.base.config import yaml_text
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dash, Level, Mark, Panel, Plot

STATIC = (
    "not identifiable by ramps; torque noise releases the shaft before it is reached, and the friction falls from it "
    "within one or two readings"
)
STIFFNESS_SHARE = 1e-4
"""Presliding of the YAML's bristles, rad: assumed, because a ramp test cannot determine it."""
METHODS = "source, m b / a", "exact, by covariance", "exact, by repeats"
_DASHES: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dashdot")
_TIME = "time since the torque's zero, s"


def _velocity_plot(part: RampIdentification) -> Plot:
    """Show the velocities of all repeats with the fitted ones, one panel for each slope (figures 4 to 6)."""
    panels: list[Panel] = []
    deviations: list[Mark] = []
    for j, slope in enumerate(slopes_of(part.ramps)):
        ramps = [ramp for ramp in part.ramps if abs(ramp.slope - slope) <= SLOPE_TOLERANCE * slope]
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


def _load_plot(result: RampTestResult) -> Plot:
    """Show one no-load and one loaded ramp of each slope on the same axes."""
    curves = []
    for k, (name, part) in enumerate(result.parts):
        for j, slope in enumerate(slopes_of(part.ramps)):
            ramp = min(part.ramps, key=lambda r: abs(r.slope - slope))
            time, velocity = measured_velocity(ramp.record)
            label = f"{name}, {slope:.3g} Nm/s"
            curves.append(Curve(time * ramp.slope, velocity, label, COLOURS[k], 1.0, _DASHES[j % 4]))
    return Plot([Panel(curves, "", "motor torque m t, Nm", "motor velocity, rad/s")], height=3.0)


def _comparison_plot(comparison: FourWay) -> Plot:
    """Show the four velocities and their differences from the closed form (figures 7 and 8)."""
    upper = []
    lower = []
    *_, closed = comparison.velocities.values()
    for k, (name, velocity) in enumerate(comparison.velocities.items()):
        style = COLOURS[k], 0.8 if name == EXPERIMENT else 1.4, _DASHES[k]
        upper.append(Curve(comparison.time, velocity, name, *style))
        lower.append(Curve(comparison.time, 100 * (velocity - closed) / closed[-1], name, *style))
    panels = [Panel(upper, y_label="motor velocity, rad/s"), Panel(lower, "", _TIME, "less closed form, %")]
    return Plot(panels, share_x=True)


def _sensor_plot(comparison: FourWay) -> Plot:
    """Show the models under the source's own input: velocities, and the other outputs of the block diagram's sensor."""
    sensor = comparison.as_source
    velocities = [
        Curve(sensor.time, velocity, name, COLOURS[k + 1], 1.4, _DASHES[k])
        for k, (name, velocity) in enumerate(comparison.source_velocities.items())
    ]
    others = (
        ("position", sensor.position, "rad"),
        ("acceleration", sensor.acceleration, "rad/s²"),
        ("reaction torque", sensor.reaction, "Nm"),
    )
    panels = [Panel(velocities, "velocity", "time, s", "motor velocity, rad/s")]
    for name, values, unit in others:
        panels.append(Panel([Curve(sensor.time, values, "block diagram", COLOURS[1])], name, "time, s", unit))
    return Plot(panels)


def _interval(estimate: IntervalEstimate) -> dict[str, Any]:
    return {
        "value": float(f"{estimate.value:.6g}"),
        "standard_uncertainty": float(f"{estimate.error:.3g}"),
        "interval_95": [float(f"{estimate.low:.6g}"), float(f"{estimate.high:.6g}")],
    }


def _source_lines(found: SourceEvaluation) -> list[str]:
    """Return the source's evaluation of these ramps with the figures that the source states."""
    title = "by the source's evaluation"
    lines = [f"{title:34}{'f_c, Nm':>10}{'s.d.':>9}{'f_v, Nm':>10}{'a, deg/s^2':>12}{'b, deg/s':>10}{'total, Nm':>11}"]
    for name, one in found.loads.items():
        for text, row in ((f"{name}, {one.ramps} ramps", one), (f"{name}, as published", SOURCE_STATES.loads[name])):
            spread = "-" if row is not one else f"{row.spread:.4f}"
            lines.append(
                f"{text:34}{row.coulomb:10.4f}{spread:>9}{row.viscous:10.2e}{row.a:12.1f}{row.b:10.1f}{row.total:11.3f}"
            )
    if found.joint is not None:
        lines.append(f"{'f_joint, published ' + str(SOURCE_STATES.joint):34}{found.joint:62.3f}")
    return lines


def write_result(out: Path, found: RampTestResult, rig: Rig, origin: str) -> None:
    """Write report.html and estimates.yaml, with every estimate, in a folder, and print the estimates.

    Args:
        out: the folder.
        found: the result of the measurement.
        rig: on which it was made.
        origin: of the data, in one line.
    """
    rows: list[tuple[str, str, RampFriction]] = [
        (name, text, friction)
        for name, part in found.parts
        for text, friction in zip(METHODS, (part.source, part.exact, part.repeated), strict=True)
        if friction is not None
    ]
    document: dict[str, Any] = {"units": {"coulomb": "Nm", "viscous": "Nm s/rad", "inertia": "kg m2"}}
    lines = _source_lines(found.as_source) if found.as_source is not None else []
    lines += [f"{'':34}{'f_c, Nm [95 %]':>34}{'f_v, Nm s/rad [95 %]':>40}"]

    def add(title: str, coulomb: IntervalEstimate, viscous: IntervalEstimate) -> dict[str, Any]:
        lines.append(f"{title:34}{coulomb!s:>34}{viscous!s:>40}")
        return {"coulomb": _interval(coulomb), "viscous": _interval(viscous)}

    for name, method, friction in rows:
        entry = add(f"{name}: {method}", friction.coulomb, friction.viscous)
        if friction.inertia is not None:
            entry["inertia"] = _interval(friction.inertia)
        document.setdefault(name, {})[method] = entry
    plots = {name: _velocity_plot(part) for name, part in found.parts}
    if found.joint is not None:
        document["joint"] = {
            "motor_side": add("joint, at the motor", *found.joint[:2]),
            "joint_side": add("joint, joint side", *found.joint[2:]),
        }
        plots["loads"] = _load_plot(found)
        lines.append(f"joint side: {rig.joint_side_reason}")
    if found.as_source is not None:
        document["as_source"] = {name: figures._asdict() for name, figures in found.as_source.loads.items()}
        document["as_source"]["f_joint"] = found.as_source.joint
    if found.comparison is not None:
        document["comparison"] = [_pair(pair) for pair in found.comparison.pairs]
        lines += [_pair_line(pair) for pair in found.comparison.pairs]
        plots["comparison"] = _comparison_plot(found.comparison)
        plots["sensor"] = _sensor_plot(found.comparison)
    unused = [*found.failures, *(reason for _, part in found.parts for reason in part.unused)]
    page = render_page(
        "friction_bench.experiment",
        "friction_report.html.j2",
        result=found,
        rig=rig,
        origin=origin,
        rows=rows,
        plots=plots,
        smoothing=SMOOTHING,
        models={"step": FIXED_STEP, "settled": SETTLED, "slope": SOURCE_SLOPE, "start": SOURCE_START, "slip": STICTION},
        static=STATIC,
        unused=unused,
        source_states=SOURCE_STATES,
        two_slopes=all(part.exact is not None for _, part in found.parts),
    )
    write_text(out / "report.html", page)
    document |= {
        "tau_s": {"identifiable": False, "reason": STATIC},
        "not_used": unused,
        "not_physical": list(found.unphysical),
    }
    write_text(out / "estimates.yaml", yaml_text(document))
    lines.append(f"static friction tau_s: {STATIC}")
    print("\n".join([*lines, *(f"not used: {reason}" for reason in unused)]))


def _pair(pair: Pair) -> dict[str, Any]:
    """Return the difference of two velocities as plain data."""
    figures = {"worst": pair.worst, "rms": pair.rms, "sliding": pair.sliding}
    rounded = {name: float(f"{value:.4g}") for name, value in figures.items()}
    return {**pair._asdict(), **rounded, "within": pair.within}


def _pair_line(pair: Pair) -> str:
    band = f"; source: ± {pair.band:g} %, {'kept' if pair.within else 'not kept'}" if pair.band else ""
    return f"{pair.first} - {pair.second}: {pair.worst:.2g} % worst, {pair.sliding:.2g} % while sliding{band}"


def write_friction(path: Path, found: RampTestResult, element: str, base: FrictionFile) -> None:
    """Write friction parameters for rx90_sim; a viscous friction that is not physical becomes 0, marked as assumed.

    Args:
        path: file to write.
        found: the result of the measurement.
        element: name of the friction element of the measured joint.
        base: the friction file that gets this element.
    """
    coulomb, viscous = found.written
    # Assumed are c0 and c1, a presliding of 0.1 mrad with critical-like damping, and tau_s, as much above tau_c as in
    # the element that is replaced.
    assumed = base.elements[element]
    stiffness = coulomb.value / STIFFNESS_SHARE
    rise = assumed.tau_s.positive / assumed.tau_c.positive
    tau_c = _rounded(coulomb.value)
    c2 = _rounded(max(viscous.value, 0.0))
    tau_s = max(_rounded(rise * coulomb.value), tau_c)
    c0 = _rounded(stiffness)
    c1 = _rounded(1e-3 * stiffness)
    values = {
        "tau_c": tau_c,
        "tau_s": tau_s,
        "omega_s": 0.05,
        "delta": 1.0,
        "c0": c0,
        "c1": c1,
        "c2": c2,
        "omega_d": 1.0,
    }
    measured = FrictionElement.of(values)
    assumption: dict[str, Any] = {"provenance": "assumed", "identifiable": False}
    identified = "tau_c and c2"
    of_c2 = {"provenance": "identified", **_interval(viscous)}
    if viscous.value <= 0.0:
        identified = "tau_c"
        of_c2 = {**assumption, "value": c2, "estimate": _interval(viscous), "reason": found.unphysical[-1]}
    source = f"ramp test on the friction rig: {identified} of {element} identified, the rest assumed"
    parameters = {
        "tau_c": {"provenance": "identified", **_interval(coulomb)},
        "c2": of_c2,
        "tau_s": {"provenance": "assumed", "value": tau_s, "identifiable": False, "reason": STATIC},
        **{name: assumption.copy() for name in ("omega_s", "delta", "c0", "c1", "omega_d")},
    }
    elements = {**base.elements.entries, element: measured}
    known = {"parameters": {element: parameters}}
    file = FrictionFile.of(elements, provenance="assumed", source=source, identification=known)
    write_text(path, file.text())


def _rounded(value: float) -> float:
    """Return a value with the six digits of a friction file."""
    return float(f"{value:.6g}")
