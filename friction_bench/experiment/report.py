"""The result of a measurement: on the terminal, as an HTML page, and as YAML that rx90_sim reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bokeh.plotting import figure

from friction_bench.experiment.four_way import (
    FIXED_STEP,
    SETTLED,
    SMOOTHING,
    SOURCE_SLOPE,
    SOURCE_START,
    STICTION,
    Pair,
)
from friction_bench.experiment.identification import (
    SOURCE_STATES,
    IntervalEstimate,
    RampFriction,
    RampTestResult,
    SourceEvaluation,
)
from friction_bench.experiment.plots import four_ways, loads, source_input, velocities
from friction_bench.rig.rig_file import Rig
from rx90_common.base.config import yaml_text
from rx90_common.base.quoting import counted
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page

STATIC = (
    "not identifiable by ramps; torque noise releases the shaft before it is reached, and the friction falls from it "
    "within one or two readings"
)
STIFFNESS_SHARE = 1e-4
"""Presliding of the YAML's bristles, rad: assumed, because a ramp test cannot determine it."""
METHODS = "source, m b / a", "exact, by covariance", "exact, by repeats"


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
        for text, row in (
            (f"{name}, {counted(one.ramps, 'ramp')}", one),
            (f"{name}, as published", SOURCE_STATES.loads[name]),
        ):
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
    of_models: dict[str, Sequence[figure]] = {}
    if found.joint is not None:
        document["joint"] = {
            "motor_side": add("joint, at the motor", *found.joint[:2]),
            "joint_side": add("joint, joint side", *found.joint[2:]),
        }
        lines.append(f"joint side: {rig.joint_side_reason}")
    if found.as_source is not None:
        document["as_source"] = {name: figures._asdict() for name, figures in found.as_source.loads.items()}
        document["as_source"]["f_joint"] = found.as_source.joint
    if found.comparison is not None:
        document["comparison"] = [_pair(pair) for pair in found.comparison.pairs]
        lines += [_pair_line(pair) for pair in found.comparison.pairs]
        of_models = {"compared": four_ways(found.comparison), "source_input": source_input(found.comparison)}
    unused = [*found.failures, *(reason for _, part in found.parts for reason in part.unused)]
    page = render_page(
        "friction_bench.experiment",
        "friction_report.html.j2",
        result=found,
        rig=rig,
        origin=origin,
        rows=rows,
        velocities=[velocities(part) for _, part in found.parts],
        loads=loads(dict(found.parts)),
        of_models=of_models,
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
