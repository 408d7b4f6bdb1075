"""The result of a measurement: on the terminal, as an HTML page, and as YAML that rx90_sim reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from friction_bench.experiment.evaluation import RampTestResult
from friction_bench.experiment.four_way import SMOOTHING
from friction_bench.experiment.identification import IntervalEstimate, RampFriction
from friction_bench.experiment.plots import comparison_plot, load_plot, velocity_plot
from friction_bench.rig.rig_file import Rig
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import IdentificationError, write_text
from rx90_common.friction import LuGreElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.report.page import render_page

STIFFNESS_SHARE = 1e-4
"""Presliding of the YAML's bristles, rad: a ramp test does not see it, so it is assumed."""


def friction_rows(result: RampTestResult) -> list[tuple[str, str, RampFriction]]:
    """Return load, method and estimate, in the report's order."""
    rows = []
    for name, part in result.parts:
        rows.append((name, "source, m b / a", part.source))
        if part.exact is not None:
            rows.append((name, "exact, by covariance", part.exact))
        if part.repeated is not None:
            rows.append((name, "exact, by repeats", part.repeated))
    return rows


def result_text(result: RampTestResult) -> str:
    """Return the estimates as a table for the terminal."""
    lines = [f"{'':34}{'f_c, Nm [95 %]':>34}{'f_v, Nm s/rad [95 %]':>40}"]
    for name, method, friction in friction_rows(result):
        lines.append(f"{name + ': ' + method:34}{_cell(friction.coulomb):>34}{_cell(friction.viscous):>40}")
    if result.joint is not None:
        joint = result.joint
        lines.append(f"{'joint, at the motor':34}{_cell(joint.coulomb):>34}{_cell(joint.viscous):>40}")
        side = joint.joint_side_coulomb, joint.joint_side_viscous
        lines.append(f"{'joint, joint side':34}{_cell(side[0]):>34}{_cell(side[1]):>40}")
    if result.comparison is not None:
        for pair in result.comparison.pairs:
            band = f", source ± {pair.band:g} %" if pair.band else ""
            lines.append(f"{pair.first} - {pair.second}: {pair.worst:.2g} % worst{band}")
    return "\n".join(lines)


def _cell(estimate: IntervalEstimate) -> str:
    return f"{estimate.value:.4g} [{estimate.low:.4g}, {estimate.high:.4g}]"


def write_html(path: Path, result: RampTestResult, rig: Rig, origin: str) -> None:
    """Write the page; `origin` says in one line where the data came from.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    plots = {name: velocity_plot(part) for name, part in result.parts}
    if result.joint is not None:
        plots["load"] = load_plot(result)
    if result.comparison is not None:
        plots["comparison"] = comparison_plot(result.comparison)
    page = render_page(
        "friction_bench.experiment",
        "friction_report.html.j2",
        result=result,
        rig=rig,
        origin=origin,
        rows=friction_rows(result),
        plots=plots,
        smoothing=SMOOTHING,
        two_slopes=all(part.exact is not None for _, part in result.parts),
    )
    write_text(path, page)


def _interval(estimate: IntervalEstimate) -> dict[str, Any]:
    return {
        "value": float(f"{estimate.value:.6g}"),
        "standard_uncertainty": float(f"{estimate.error:.3g}"),
        "interval_95": [float(f"{estimate.low:.6g}"), float(f"{estimate.high:.6g}")],
    }


def _lugre(coulomb: float, static: float, viscous: float) -> LuGreElement:
    """Return a LuGre element: c0 and c1 give a presliding of 0.1 mrad with critical-like damping, assumed."""
    stiffness = coulomb / STIFFNESS_SHARE
    tau_c, tau_s, c0, c1, c2 = (
        float(f"{value:.6g}") for value in (coulomb, static, stiffness, 1e-3 * stiffness, max(viscous, 0.0))
    )
    return LuGreElement(tau_c, tau_c, tau_s, tau_s, 0.05, 1.0, c0, c1, c2, 1.0)


def _static_friction(result: RampTestResult, rig: Rig) -> float:
    """Return the joint's break-away torque on its own side of the gear, Nm, 0 where it was not measured."""
    if result.loaded is None or result.unloaded is None:
        return 0.0
    at_motor = result.loaded.break_away_torque - result.unloaded.best.coulomb.value
    return at_motor * rig.gear_ratio * rig.gear_efficiency


def write_yaml(path: Path, result: RampTestResult, rig: Rig, element: str, base: FrictionFile) -> None:
    """Write friction parameters for rx90_sim.

    Args:
        path: file to write.
        result: of the measurement.
        rig: for the gear.
        element: name of the friction element that the measured joint stands for.
        base: the friction file to put that element into.

    Raises:
        IdentificationError: if the joint's friction is not positive.
        Rx90Error: if the file cannot be written.
    """
    if result.joint is not None:
        coulomb, viscous = result.joint.joint_side_coulomb.value, result.joint.joint_side_viscous.value
    else:
        best = result.parts[0][1].best
        coulomb, viscous = best.coulomb.value, best.viscous.value
    if coulomb <= 0.0:
        raise IdentificationError(f"the Coulomb friction is {coulomb:.4g} Nm; accepted for a friction file: > 0")
    measured = _lugre(coulomb, max(coulomb, _static_friction(result, rig)), viscous)
    source = "ramp test on the friction rig: tau_c, tau_s, c2 of one element identified, its rest assumed"
    write_text(path, FrictionFile({**base.elements, element: measured}, "identified", source).text())


def write_estimates(path: Path, result: RampTestResult) -> None:
    """Write every estimate with its uncertainty as YAML.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    document: dict[str, Any] = {"units": {"coulomb": "Nm", "viscous": "Nm s/rad", "inertia": "kg m2"}}
    for name, method, friction in friction_rows(result):
        entry = {"coulomb": _interval(friction.coulomb), "viscous": _interval(friction.viscous)}
        if friction.inertia is not None:
            entry["inertia"] = _interval(friction.inertia)
        document.setdefault(name, {})[method] = entry
    if result.joint is not None:
        document["joint"] = {
            "motor_side": {
                "coulomb": _interval(result.joint.coulomb),
                "viscous": _interval(result.joint.viscous),
            },
            "joint_side": {
                "coulomb": _interval(result.joint.joint_side_coulomb),
                "viscous": _interval(result.joint.joint_side_viscous),
            },
        }
    write_text(path, yaml_text(document))
