"""The report of an identification: one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from rx90_common.friction.parameters import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_emulator.identification.estimate import PARAMETERS
from rx90_emulator.identification.identify import Identification
from rx90_emulator.identification.output.plots import correlation_plots, curve_plots, hysteresis_plot, validation_plot
from rx90_emulator.identification.output.validation import Validation
from rx90_emulator.identification.output.wording import value_and_deviation
from rx90_emulator.identification.records.record import JointRecord


def report_page(
    result: Identification,
    checks: Sequence[Validation],
    friction_file: str,
    used: Sequence[tuple[str, JointRecord]],
    fallback_name: str | None,
    now: datetime | None = None,
) -> str:
    """Return the page's text.

    Args:
        result: what was identified.
        checks: against bags that were not used.
        friction_file: its name.
        used: each record with what it was used for.
        fallback_name: file of the values that the data do not tell.
        now: date of the identification; by default the present.
    """
    named = list(zip(result.arm.element_names, result.elements, strict=True))
    untold = [
        (name, parameter, estimate.reason, getattr(one.element, parameter))
        for name, one in named
        for parameter, estimate in one.estimates.items()
        if not estimate.identifiable
    ]
    return render_page(
        "rx90_emulator.identification.output",
        "identification.html.j2",
        elements=named,
        parameters=PARAMETERS,
        units=FRICTION_UNITS,
        text=value_and_deviation,
        untold=untold,
        fallback=fallback_name,
        fading=[(name, one.element.omega_d) for name, one in named if math.isfinite(one.element.omega_d)],
        shared=result.arm.element_names[len(result.arm.names) :],
        checks=[(check, Path(check.source).name, validation_plot(check)) for check in checks],
        friction_file=friction_file,
        date=(now or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC"),
        used=used,
        plateaus=result.sliding.plateaus,
        motions=result.presliding.motions,
        curves=curve_plots(result),
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops],
        correlations=correlation_plots(result),
    )
