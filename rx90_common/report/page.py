"""The HTML page of every report: one frame with the style, and Bokeh's figures in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache

from bokeh.embed import components
from bokeh.plotting import figure
from bokeh.resources import Resources
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup

from rx90_common.base.share import share_directory
from rx90_common.report.charts import THEME, join, thin

_RESOURCES = Resources(mode="inline", components=["bokeh"], log_level="warn")
_PLACE = "<!--figure {}-->"  # text from outside is escaped, so that nobody else writes it
_TERMS = "<!--terms-->"
_LOT = r"\w{8}-\w{4}-\w{4}-\w{4}-\w{12}"
_NO_SCRIPT = "<noscript>Plots need JavaScript; text and tables of this page do not.</noscript>"


@cache
def _environment(package: str) -> Environment:
    loaders = [PackageLoader(package), PackageLoader("rx90_common.report")]
    return Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )


@cache
def _terms() -> Markup:
    """Return the documentation's glossary and works as HTML; their links to other pages become text."""
    text = (share_directory() / "docs/reference/glossary_and_works.md").read_text(encoding="utf-8")
    text = re.sub(r"\[([^]]*)\]\((?!https:)[^)]*\)", r"\1", text.partition("\n## ")[2])
    return Markup(MarkdownIt("commonmark").enable("table").render("## " + text))


def render_page(
    package: str, template: str, words: Callable[[str], str] = str, **values: object
) -> str:
    """Return a self-contained HTML page.

    In a template, `draw(figures, across)` inserts one figure of Bokeh or several: below each other, or so many side by
    side where the window is wide enough.

    Args:
        package: the package whose folder `templates` holds the template.
        template: its file, which extends `page.html.j2` and fills the blocks title, summary and content.
        words: changes the page's text outside the figures, such as its units.
        values: for the names in the template; a missing name is an error.
    """
    figures: list[figure] = []

    def draw(shown: figure | Sequence[figure], across: int = 1) -> Markup:
        """Return the places of figures until all of the page, which share its size, are known."""
        together = [shown] if isinstance(shown, figure) else shown
        join(together)
        places = [_PLACE.format(len(figures) + k) for k in range(len(together))]
        figures.extend(together)
        kind = f"plot across{across}" if across > 1 else "plot"
        return Markup(f'<figure class="{kind}">{_NO_SCRIPT}{"".join(places)}</figure>')

    page = _environment(package).get_template(template).render(values, draw=draw)
    page = words(page).replace(_TERMS, _terms())
    if not figures:
        return page
    most = thin(figures)
    script, places = _numbered(*components(figures, theme=THEME))
    page = re.sub(_PLACE.format(r"(\d+)"), lambda place: places[int(place[1])], page)
    scripts = _environment("rx90_common.report").get_template("plots.html.j2")
    page = page.replace(
        "</body>",
        scripts.render(library=Markup(_RESOURCES.render_js()), script=Markup(script)) + "\n</body>",
    )
    if most:
        note = f"Of long curves the first, least, largest and last value in each of {most // 4} parts are shown."
        page = page.replace("<footer>", f"<footer>{note} ", 1)
    return page


def _numbered(script: str, places: Sequence[str]) -> tuple[str, list[str]]:
    """Return Bokeh's texts with numbers for the names that it draws by lot or counts through the process.

    So equal figures give equal texts. Only ends of `"id":` are names among the documents, where labels stand, too.
    """
    numbers: dict[str, str] = {}

    def number(name: re.Match[str]) -> str:
        return numbers.setdefault(name[0], f"plot-{len(numbers)}")

    documents, key, items = script.rpartition("const render_items")
    documents = re.sub(rf'(?<="id":")[^"]+|(?<=docs_json = .{{2}}"){_LOT}', number, documents)
    names = re.compile(rf"(?<=\")(?:{_LOT}|p\d+)(?=\")")
    return f"{documents}{key}{names.sub(number, items)}", [
        names.sub(number, place) for place in places
    ]
