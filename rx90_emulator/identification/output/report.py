"""The pages of an identification from sweeps or excitation runs, a check of a friction file and a measured run.

A report is one self-contained HTML page. Tables and sentences are in the templates, which share `_macros.html.j2`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from bokeh.plotting import figure

from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_emulator.identification.estimates import IdentifiedElement
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.output import plots, summary
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import ExcitationIdentification
from rx90_emulator.identification.validation.measured import MeasuredComparison
from rx90_emulator.identification.validation.prediction import Validation


def _render(template: str, date: datetime | None = None, unit: str = "Nm", **values: Any) -> str:
    """Return a page on torques in a unit; templates can use the functions of `summary`, and `values`."""
    day = (date or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC")
    return render_page(
        "rx90_emulator.identification.output",
        template,
        partial(in_unit, unit=unit),
        date=day,
        summary=summary,
        zip=zip,
        **values,
    )


def _checks(checks: Sequence[Validation]) -> list[tuple[Validation, str, list[figure]]]:
    """Return validations with the names of their bags, and their plots."""
    return [
        (check, Path(check.source).name, [*plots.torques(check.torque, check.names, check.unit), *plots.tips(check)])
        for check in checks
    ]


def _friction(names: Sequence[str], elements: Sequence[IdentifiedElement]) -> dict[str, Any]:
    """Return what templates show of identified friction: rows, columns with units, what is lacking."""
    rows = summary.friction_rows(names, elements)
    columns = []
    for column in summary.friction_columns(rows):
        name = column.rstrip("+-")
        columns.append((column, FRICTION_UNITS.get(name) or FRICTION_UNITS.get(f"{name}_positive", "")))
    return {"friction": rows, "columns": columns, "lacking": summary.lacking(names, elements)}


def check_page(checks: Sequence[Validation], friction_file: str) -> str:
    """Return the text of the page on the comparison of a friction file with bags.

    Args:
        checks: one for each bag.
        friction_file: name of the file.
    """
    unit = checks[0].unit
    return _render("friction_check.html.j2", unit=unit, checks=_checks(checks), friction_file=friction_file)


def measured_page(result: MeasuredComparison, files: tuple[str, ...]) -> str:
    """Return the text of the page on a measured run.

    Args:
        result: of the comparison.
        files: that the robot was read from.
    """
    return _render(
        "measured.html.j2",
        result=result,
        files=files,
        torques=plots.torques(result.torque, result.names, "Nm", "simulated"),
        positions=plots.measured_positions(result),
    )


def report_page(result: FrictionIdentification, friction_file: str) -> str:
    """Return the text of the page on an identification from sweeps and micro-oscillations.

    Args:
        result: the identification.
        friction_file: name of the file with the values.
    """
    names = result.arm.element_names
    sliding = result.sliding
    presliding = result.presliding
    curves = [(name, curve) for name, curve in zip(names, sliding.curves, strict=True) if curve is not None]
    return _render(
        "identification.html.j2",
        result=result,
        **_friction(names, result.elements),
        truth=result.truth,
        bristles=[name for name, one in zip(names, result.elements, strict=True) if one.given_bristles],
        fading=[
            (name, identified.element.omega_d)
            for name, identified in zip(names, result.elements, strict=True)
            if math.isfinite(identified.element.omega_d)
        ],
        shared=names[len(result.arm.names) :],
        checks=_checks(result.validations),
        friction_file=friction_file,
        curves=[plots.sliding_curve(name, curve) for name, curve in curves],
        loops=[plots.presliding_loop(joint, *loop) for joint, loop in presliding.loops.items()],
    )


def excitation_page(
    result: ExcitationIdentification, date: datetime, versions: Mapping[str, str], files: Sequence[str]
) -> str:
    """Return the text of the page on an identification from excitation runs.

    Args:
        result: the identification.
        date: of the identification.
        versions: of interpreter and libraries.
        files: names of the robot's files, and last a sentence about them.
    """
    checked = [one.torques for one in result.validations]
    longest = max(result.torques, key=lambda run: run.source.duration)
    return _render(
        "excitation.html.j2",
        date,
        result.unit,
        result=result,
        files=files,
        versions=", ".join(f"{name} {number}" for name, number in versions.items()),
        **_friction(result.problem.arm.element_names, result.elements),
        truth={},
        runs=[*(("fitted", run) for run in result.torques), *(("not used", run) for run in checked)],
        drawn=[(run, plots.torques(run, run.names, result.unit)) for run in (checked[:2] or [longest])],
        curves=plots.friction_curves(result, result.unit),
    )
