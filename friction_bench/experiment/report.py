"""The result of a measurement: on the terminal, as an HTML page, and as YAML that rx90_sim reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bokeh.plotting import figure

from friction_bench.experiment import four_way
from friction_bench.experiment.four_way import Pair
from friction_bench.experiment.identification import (
    SOURCE_STATES,
    IntervalEstimate,
    RampFriction,
    RampTestResult,
)
from friction_bench.experiment.plots import four_ways, loads, source_input, velocities
from friction_bench.rig.rig_file import Rig
from rx90_common.base.config import yaml_text
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
METHODS = "source, m b / a", "exact, by covariance"


def _interval(estimate: IntervalEstimate) -> dict[str, Any]:
    return {
        "value": _rounded(estimate.value),
        "standard_uncertainty": float(f"{estimate.error:.3g}"),
        "interval_95": [_rounded(estimate.low), _rounded(estimate.high)],
    }


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
        for text, friction in zip(METHODS, (part.source, part.exact), strict=True)
        if friction is not None
    ]
    document: dict[str, Any] = {
        "units": {"coulomb": "Nm", "viscous": "Nm s/rad", "inertia": "kg m2"}
    }
    lines = [f"{'':34}{'f_c, Nm [95 %]':>34}{'f_v, Nm s/rad [95 %]':>40}"]

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
        document["as_source"] = {
            name: figures._asdict() for name, figures in found.as_source.loads.items()
        }
        document["as_source"]["f_joint"] = found.as_source.joint
    if found.comparison is not None:
        document["comparison"] = [
            pair._asdict() | {"within": pair.within} for pair in found.comparison.pairs
        ]
        lines += [_pair_line(pair) for pair in found.comparison.pairs]
        of_models = {
            "compared": four_ways(found.comparison),
            "source_input": source_input(found.comparison),
        }
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
        models=four_way,
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


def _pair_line(pair: Pair) -> str:
    band = (
        f"; source: ± {pair.band:g} %, {'kept' if pair.within else 'not kept'}" if pair.band else ""
    )
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
    static = coulomb.value * assumed.tau_s.positive / assumed.tau_c.positive
    viscosity = max(viscous.value, 0.0)
    values = {
        "tau_c": coulomb.value,
        "tau_s": static,
        "omega_s": 0.05,
        "delta": 1.0,
        "c0": stiffness,
        "c1": 1e-3 * stiffness,
        "c2": viscosity,
        "omega_d": 1.0,
    }
    measured = FrictionElement.of({name: _rounded(value) for name, value in values.items()})
    assumption: dict[str, Any] = {"provenance": "assumed", "identifiable": False}
    identified = "tau_c and c2"
    of_c2 = {"provenance": "identified", **_interval(viscous)}
    if viscous.value <= 0.0:
        identified = "tau_c"
        of_c2 = {
            **assumption,
            "value": _rounded(viscosity),
            "estimate": _interval(viscous),
            "reason": found.unphysical[-1],
        }
    source = (
        f"ramp test on the friction rig: {identified} of {element} identified, the rest assumed"
    )
    parameters = {
        "tau_c": {"provenance": "identified", **_interval(coulomb)},
        "c2": of_c2,
        "tau_s": {**assumption, "value": _rounded(static), "reason": STATIC},
        **{name: assumption.copy() for name in ("omega_s", "delta", "c0", "c1", "omega_d")},
    }
    elements = {**base.elements.entries, element: measured}
    known = {"parameters": {element: parameters}}
    file = FrictionFile.of(elements, provenance="assumed", source=source, identification=known)
    write_text(path, file.text())


def _rounded(value: float) -> float:
    """Return a value with the six digits of a friction file."""
    return float(f"{value:.6g}")
