"""The report of an identification: one self-contained HTML page."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from pathlib import Path

from rx90_common.friction.parameters import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_emulator.identification.model.estimates import PARAMETERS
from rx90_emulator.identification.output.plots import correlation_plots, curve_plots, hysteresis_plot, validation_plot
from rx90_emulator.identification.result.identification import FrictionIdentification


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
        parameters=PARAMETERS,
        units=FRICTION_UNITS,
        unidentifiable=unidentifiable,
        fallback=result.fallback_name,
        fading=[(name, one.element.omega_d) for name, one in named if math.isfinite(one.element.omega_d)],
        shared=result.arm.element_names[len(result.arm.names) :],
        checks=[(check, Path(check.source).name, validation_plot(check)) for check in result.validations],
        friction_file=friction_file,
        date=(now or datetime.now(timezone.utc)).strftime("%Y-%m-%d %H:%M UTC"),
        bags=result.bags,
        plateaus=result.sliding.plateaus,
        motions=result.presliding.motions,
        curves=curve_plots(result),
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops],
        correlations=correlation_plots(result),
    )
