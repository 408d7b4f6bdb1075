"""The report of an identification: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined

from rx90_identification.estimate import PARAMETERS, Source
from rx90_identification.identify import Identification
from rx90_identification.plots import correlation_plot, curves_plot, hysteresis_plot, validation_plot
from rx90_identification.validation import Validation

_UNITS = dict(zip(PARAMETERS, ("Nm", "Nm", "Nm", "Nm", "rad/s", "1", "Nm s/rad", "Nm/rad", "Nm s/rad"), strict=True))


def report_page(result: Identification, checks: Sequence[Validation], friction_file: str) -> str:
    """Return the page's text."""
    environment = Environment(
        loader=PackageLoader("rx90_identification"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    sources = dict.fromkeys(bag for one in result.elements for bags in one.sources.values() for bag in bags)
    named = list(zip(result.arm.element_names, result.elements, strict=True))
    untold = [
        (name, parameter, estimate.reason, getattr(one.element, parameter))
        for name, one in named
        for parameter, estimate in one.estimates.items()
        if not estimate.identifiable
    ]
    return environment.get_template("identification.html.j2").render(
        elements=named,
        parameters=PARAMETERS,
        units=_UNITS,
        untold=untold,
        checks=[(check, validation_plot(check)) for check in checks],
        friction_file=friction_file,
        sources=[(str(bag.path), _short(bag)) for bag in sources],
        plateaus=result.sliding.plateaus,
        motions=result.presliding.motions,
        curves=curves_plot(result),
        loops=[hysteresis_plot(loop) for loop in result.presliding.loops],
        correlation=correlation_plot(result),
    )


def _short(bag: Source) -> str:
    return bag.sha256[:16]
