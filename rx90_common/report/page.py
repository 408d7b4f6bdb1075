"""The HTML page that every report is: one environment, one frame with the style, and one way to write it."""

from __future__ import annotations

from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined


@cache
def _environment(package: str) -> Environment:
    loaders = [PackageLoader(package), PackageLoader("rx90_common.report")]
    return Environment(loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True)


def render_page(package: str, template: str, **values: object) -> str:
    """Return a self-contained HTML page.

    Args:
        package: the package whose folder `templates` holds the template.
        template: its file, which extends `page.html.j2` and fills the blocks title, summary and content.
        values: what the template names; a name that is missing is an error.
    """
    return _environment(package).get_template(template).render(values)
