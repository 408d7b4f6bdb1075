"""Plots, what is drawn of curves and how, and the frame that all reports share."""

from __future__ import annotations

import base64
import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError

from rx90_common.base.share import PACKAGES, ROOT
from rx90_common.report.page import plot_json, render_page
from rx90_common.report.picture import as_svg, write_picture
from rx90_common.report.plot import Band, Curve, Dots, Level, Panel, Plot

pytestmark = pytest.mark.slow

TIME = np.linspace(0.0, 8.0, 8001)
NOISE = np.random.default_rng(5).normal(size=len(TIME))


def panel(*marks: Curve | Dots | Band | Level, **options: object) -> Panel:
    """Return a panel with labels."""
    return Panel(marks, "a title", "time, s", "torque, Nm", **options)  # type: ignore[arg-type]


def arrays(text: str) -> list[np.ndarray]:
    """Return the arrays that stand in Bokeh's JSON."""
    found = re.findall(r'"data":"([^"]*)"\},"shape":\[\d+\],"dtype":"(\w+)"', text)
    return [np.frombuffer(gzip.decompress(base64.b64decode(data)), kind).astype(np.float64) for data, kind in found]


def test_numbers_in_the_page_keep_their_precision_far_from_zero() -> None:
    """What is zoomed is right to 1e-5 of its range, also a small motion about a large angle."""
    for offset, size in ((1.5, 1e-6), (0.5, 1.0), (1e6, 1.0)):
        values = offset + size * NOISE[:100]
        stored = arrays(plot_json(Plot([panel(Dots(TIME[:100], values))])))
        assert min(np.abs(found - values).max() for found in stored if len(found) == 100) < 1e-5 * np.ptp(values)


def test_equal_plots_are_equal_bytes(tmp_path: Path) -> None:
    """Pictures of each format and the data to be zoomed hold no date, chance or counter."""

    def plot() -> Plot:
        x = np.array([-2.0, -0.1, 0.1, 1.0])
        return Plot([panel(Curve(x, x**2, "square"), Dots(x, x, "line", error=x**2), x_scale="symlog", smallest=0.1)])

    assert as_svg(plot()) == as_svg(plot())
    assert plot_json(plot()) == plot_json(plot())
    assert '"name":"p1"' in plot_json(Plot([panel(Curve(TIME[:2], NOISE[:2], "p1"))]))  # named like Bokeh's models
    for suffix, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        pictures = [tmp_path / f"{k}{suffix}" for k in range(2)]
        for picture in pictures:
            write_picture(plot(), picture, "a title")
        first, second = (picture.read_bytes() for picture in pictures)
        assert first.startswith(start)
        assert first == second


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
    assert REPORTS
    assert not any(word in page for word in ("http:", "https:", "src=", "<link", "@import", "url("))
    assert "default-src 'none'" in page
    assert len(page) < 25_000


@pytest.mark.parametrize("name", REPORTS)
def test_a_value_that_is_missing_is_an_error(name: str) -> None:
    """A template never shows a gap where a value was forgotten."""
    package = ".".join(REPORTS[name].relative_to(ROOT).parts[:-2])
    with pytest.raises(UndefinedError):
        render_page(package, name)
