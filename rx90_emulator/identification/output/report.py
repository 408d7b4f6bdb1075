"""The pages of an identification and of a check of a friction file: one self-contained HTML file each.

Tables and sentences are in the templates, which share `_macros.html.j2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from bokeh.plotting import figure

from rx90_common.base.share import versions
from rx90_common.report.page import render_page
from rx90_emulator.identification.output import plots, summary
from rx90_emulator.identification.records import in_unit
from rx90_emulator.identification.result import (
    ExcitationIdentification,
    Identification,
)
from rx90_emulator.identification.validation.prediction import Validation


def _render(template: str, date: datetime, unit: str, **values: Any) -> str:
    """Return a page on torques in a unit; templates can use the functions of `summary`, and `values`."""
    day = f"{date:%Y-%m-%d %H:%M} UTC"
    package = "rx90_emulator.identification.output"
    words = partial(in_unit, unit=unit)
    return render_page(package, template, words, date=day, summary=summary, zip=zip, **values)


def _checks(checks: Sequence[Validation]) -> list[tuple[Validation, str, list[figure]]]:
    """Return validations with the names of their bags, and their plots."""
    shown = []
    for check in checks:
        figures = plots.torques(check.torque, check.torque.names, unit=check.torque.source.unit)
        if check.tip is not None:
            figures.append(plots.tips(check.tip))
        shown.append((check, Path(check.source).name, figures))
    return shown


def check_page(checks: Sequence[Validation], friction_file: str) -> str:
    """Return the text of the page on the comparison of a friction file with bags.

    Args:
        checks: one for each bag.
        friction_file: name of the file.
    """
    now = datetime.now(timezone.utc)
    shown = _checks(checks)
    unit = checks[0].torque.source.unit
    return _render("friction_check.html.j2", now, unit, checks=shown, friction_file=friction_file)


def identification_page(result: Identification, files: Sequence[str]) -> str:
    """Return the text of the page on an identification.

    Args:
        result: the identification.
        files: names of the files, and last a sentence about them.
    """
    rows = summary.friction_rows(result)
    return _render(
        "identification.html.j2",
        result.date,
        result.unit,
        result=result,
        kind="excitation" if isinstance(result, ExcitationIdentification) else "sweeps",
        files=files,
        versions=", ".join(f"{name} {number}" for name, number in versions().items()),
        names=result.arm.element_names,
        friction=rows,
        columns=summary.friction_columns(rows),
        lacking=summary.lacking(result),
        checks=_checks(result.validations),
        curves=[
            plots.friction_curve(name, curve, result.unit) for name, curve in result.curves.items()
        ],
    )
