"""The HTML page that every report is: one environment, one frame with the style, and one way to put plots into it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from rx90_common.report.live import bokeh_scripts, plot_json
from rx90_common.report.plot import Plot
from rx90_common.report.simplifying import points_needed, share_of_points
from rx90_common.report.still import as_svg
from rx90_common.report.thinning import thinned

_MOST_BYTES = 3_000_000  # of a page with plots; BokehJS takes 1.4 MB of them
_POINTS_TO_ZOOM = 80_000  # in all curves of a page
_POINT_BYTES = 10  # and a little more, in base64
_POINTS_OF_STILLS = 40_000  # 13 bytes each
_LEAST_SHARE = 10  # points to zoom of a curve; fewer would not make a page of so many much smaller
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
        self._plots.append(thinned(plot))
        return Markup(_PLACE.format(len(self._plots) - 1))

    def scripts(self) -> tuple[Markup, ...]:
        """Return the scripts that the plots so far need: what they are zoomed with stands in a page once, if at all."""
        return tuple(map(Markup, bokeh_scripts())) if self._plots else ()

    def filled(self, page: str) -> str:
        """Return the page with its plots."""
        if not self._plots:
            return page
        needed = points_needed(self._plots)
        share = share_of_points(needed, _POINTS_OF_STILLS)
        stills = [
            f'<figure class="plot"><div class="still">{as_svg(plot, share)}</div>'
            '<div class="legend"></div><div class="live"></div>'
            for plot in self._plots
        ]
        left = _MOST_BYTES - sum(len(text.encode()) for text in (page, *stills))
        elements = [
            f"{still}{to_zoom}</figure>" for still, to_zoom in zip(stills, self._to_zoom(needed, left), strict=True)
        ]
        return re.sub(_PLACE.format(r"(\d+)"), lambda place: elements[int(place[1])], page)

    def _to_zoom(self, needed: Sequence[int], left: int) -> list[str]:
        """Return what the plots are zoomed from, with as many points as there are bytes left for."""
        together = min(sum(needed), _POINTS_TO_ZOOM)
        while True:
            share = share_of_points(needed, together)
            texts = [f'<script type="application/json">{plot_json(plot, share)}</script>' for plot in self._plots]
            beyond = sum(map(len, texts)) + len("</figure>") * len(texts) - left
            if beyond <= 0 or share <= _LEAST_SHARE:
                return texts
            together = max(0, together - beyond // _POINT_BYTES - 1)
