"""The frame that all reports share, and the plots in it."""

from __future__ import annotations

import re

import pytest
from jinja2 import UndefinedError

from rx90_common.base.share import PACKAGES, ROOT
from rx90_common.report.page import render_page

TEMPLATES = {
    path.name: path
    for package in PACKAGES
    for path in sorted((ROOT / package).glob("**/templates/*.j2"))
    if path.parents[1] != ROOT / "rx90_common" / "report"
}
REPORTS = {name: path for name, path in TEMPLATES.items() if not name.startswith("_")}  # the others are parts of these


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_report_stands_in_the_one_frame(name: str) -> None:
    """A report's template extends the shared page; neither it nor a part of it has a head or a style of its own."""
    text = TEMPLATES[name].read_text(encoding="utf-8")
    assert text.startswith('{% extends "page.html.j2" %}') == (name in REPORTS)
    assert not any(tag in text for tag in ("<html", "<head", "<style", 'style="', "<h1"))


def test_the_frame_loads_nothing_from_elsewhere() -> None:
    """The page refers to nothing outside itself and forbids the browser to load anything; without plots it is small."""
    page = render_page("rx90_common.report", "page.html.j2")
    page, works = re.subn(r'<a href="https://[^"]*">', "", page)  # for the reader; the browser does not follow
    assert works > 30
    assert page.startswith("<!doctype html>")
    assert len(REPORTS) == 10
    assert not any(word in page for word in ("http:", "https:", "src=", "<link", "@import", "url("))
    assert "default-src 'none'" in page
    assert len(page) < 25_000


@pytest.mark.parametrize("name", REPORTS)
def test_a_value_that_is_missing_is_an_error(name: str) -> None:
    """A template never shows a gap where a value was forgotten."""
    package = ".".join(REPORTS[name].relative_to(ROOT).parts[:-2])
    with pytest.raises(UndefinedError):
        render_page(package, name)
