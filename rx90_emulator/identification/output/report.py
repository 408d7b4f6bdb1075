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
    kind_plot,
    validation_plot,
)
from rx90_emulator.identification.output.summary import which
from rx90_emulator.identification.presliding.kind_model import MOST_MOTIONS, MOST_OF_BAG
from rx90_emulator.identification.presliding.kinds import DISTINGUISHABLE_SE, decisions
from rx90_emulator.identification.result.identification import (
    FrictionIdentification,
    IdentifiedElement,
    shown_parameters,
)
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
    compared = [kind for kind in result.kinds if kind.choice is not None]
    own_bristles = [kind.element for kind in compared if kind.trial is not None]
    return render_page(
        "rx90_emulator.identification.output",
        "identification.html.j2",
        elements=[pair for pair in named if pair[0] in result.told],
        others=[name for name in result.arm.element_names if name not in result.told],
        truth=result.truth,
        scope=result.scope,
        assumed=[(which(names), reason) for reason, names in result.unidentifiable.items()],
        parameters=shown_parameters(result),
        units=FRICTION_UNITS,
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
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops if loop.joint not in own_bristles],
        own_bristles=own_bristles,
        compared=compared,
        decisions=decisions(result.kinds),
        given=result.with_given_bristles,
        numbers=[(name, *row) for name, one in named if not one.given_bristles for row in _own_numbers(one)],
        families=[trial.family.name for kind in compared[:1] if kind.choice for trial in kind.choice.trials],
        most_motions=MOST_MOTIONS,
        most_of_bag=MOST_OF_BAG,
        told=DISTINGUISHABLE_SE,
        kind_loops=[kind_plot(kind) for kind in compared],
        correlations=correlation_plots(result),
    )


def _own_numbers(one: IdentifiedElement) -> list[tuple[str, str, str]]:
    """Return name, value and deviation of the numbers of an element's own bristles; no deviation where assumed."""
    found = []
    for name, estimate in one.estimates.items():
        if name.startswith("bristles."):
            value, deviation = estimate.texts() if estimate.identifiable else (f"{one.value(name):.4g}", "")
            found.append((name.removeprefix("bristles."), value, deviation))
    return found
