"""The HTML page that every report is: one environment, one frame with the style, and one way to put plots into it."""

from __future__ import annotations

import re
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from rx90_common.report.live import bokeh_scripts, plot_json
from rx90_common.report.plot import Plot, points_for_each
from rx90_common.report.still import as_svg

# BokehJS takes 1.4 MB; with these a page stays below 3 MB.
_POINTS_TO_ZOOM = 60_000  # in all curves of a page, 11 bytes each
_POINTS_OF_STILLS = 40_000  # 13 bytes each
_PLACE = "<!--plot {}-->"  # text from outside is escaped, so that nobody else writes it


@cache
def _environment(package: str) -> Environment:
    loaders = [PackageLoader(package), PackageLoader("rx90_common.report")]
    return Environment(loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True)


def render_page(package: str, template: str, **values: object) -> str:
    """Return a self-contained HTML page. In a template, `draw(plot)` puts a plot there: still, and to be zoomed.

    Args:
        package: the package whose folder `templates` holds the template.
        template: its file, which extends `page.html.j2` and fills the blocks title, summary and content.
        values: what the template names; a name that is missing is an error.
    """
    plots = _PlotsOfPage()
    known = values | {"draw": plots.draw, "plot_scripts": plots.scripts}
    return plots.filled(_environment(package).get_template(template).render(known))


class _PlotsOfPage:
    """The plots of a page. They are drawn when all are known, as they share its size."""

    def __init__(self) -> None:
        self._plots: list[Plot] = []

    def draw(self, plot: Plot) -> Markup:
        """Return what stands in a plot's place until the page is filled."""
        self._plots.append(plot)
        return Markup(_PLACE.format(len(self._plots) - 1))

    def scripts(self) -> tuple[Markup, ...]:
        """Return the scripts that the plots so far need: what they are zoomed with stands in a page once, if at all."""
        return tuple(map(Markup, bokeh_scripts())) if self._plots else ()

    def filled(self, page: str) -> str:
        """Return the page with its plots."""
        if not self._plots:
            return page
        to_zoom, still = (points_for_each(self._plots, most) for most in (_POINTS_TO_ZOOM, _POINTS_OF_STILLS))
        elements = [
            f'<figure class="plot"><div class="still">{as_svg(plot, still)}</div>'
            '<div class="legend"></div><div class="live"></div>'
            f'<script type="application/json">{plot_json(plot, to_zoom)}</script></figure>'
            for plot in self._plots
        ]
        return re.sub(_PLACE.format(r"(\d+)"), lambda place: elements[int(place[1])], page)
