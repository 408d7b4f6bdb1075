"""The report of an identification: one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from rx90_common.friction.parameters import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_common.report.plot import Plot
from rx90_emulator.identification.output.plots import (
    correlation_plots,
    curve_plots,
    drift_plots,
    hysteresis_plot,
    validation_plot,
)
from rx90_emulator.identification.result.identification import FrictionIdentification, shown_parameters
from rx90_emulator.identification.result.validation import Validation


def check_page(checks: Sequence[Validation], friction_file: str, now: datetime | None = None) -> str:
    """Return the text of the page on a friction file that was held against bags.

    Args:
        checks: one for each bag.
        friction_file: name of the file.
        now: date of the comparison; by default the present.
    """
    return render_page(
        "rx90_emulator.identification.output",
        "friction_check.html.j2",
        checks=_drawn(checks),
        friction_file=friction_file,
        date=_date(now),
    )


def _drawn(checks: Sequence[Validation]) -> list[tuple[Validation, str, Plot]]:
    return [(check, Path(check.source).name, validation_plot(check)) for check in checks]


def _date(now: datetime | None) -> str:
    return (now or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC")


def report_page(result: FrictionIdentification, friction_file: str, now: datetime | None = None) -> str:
    """Return the page's text.

    Args:
        result: what was identified.
        friction_file: name of the file with the values.
        now: date of the identification; by default the present.
    """
    named = list(zip(result.arm.element_names, result.elements, strict=True))
    unidentifiable = [
        (name, parameter, estimate.reason, getattr(one.element, parameter))
        for name, one in named
        for parameter, estimate in one.estimates.items()
        if not estimate.identifiable
    ]
    return render_page(
        "rx90_emulator.identification.output",
        "identification.html.j2",
        elements=named,
        parameters=shown_parameters(result),
        units=FRICTION_UNITS,
        unidentifiable=unidentifiable,
        fallback=result.fallback_name,
        fading=[(name, one.element.omega_d) for name, one in named if math.isfinite(one.element.omega_d)],
        shared=result.arm.element_names[len(result.arm.names) :],
        checks=_drawn(result.validations),
        friction_file=friction_file,
        date=_date(now),
        bags=result.bags,
        quality=[pair for pair in zip(result.arm.element_names, result.sliding.quality, strict=True) if pair[1]],
        usage=[(use, use.text(result.arm.element_names)) for use in result.sliding.usage],
        zeros=result.sliding.zeros,
        trends=drift_plots(result),
        plateaus=result.sliding.plateaus,
        motions=result.presliding.motions,
        curves=curve_plots(result),
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops],
        correlations=correlation_plots(result),
    )
