"""Plots, what is drawn of curves and how, and the frame that all reports share."""

import re
from pathlib import Path

import numpy as np
import pytest
from bokeh.models import PlainText
from jinja2 import UndefinedError

from rx90_common.base.share import PACKAGES, ROOT
from rx90_common.report.charts import MOST_POINTS, chart, few_points, join, thin
from rx90_common.report.page import render_page
from rx90_common.report.picture import picture

pytestmark = pytest.mark.slow

TIME = np.linspace(0.0, 8.0, 8001)
TEX = r"$$\frac{a$b"


def test_equal_pictures_are_equal_bytes(tmp_path: Path) -> None:
    """Pictures of each format hold no date, chance or counter."""
    for suffix, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        pictures = [tmp_path / f"{k}{suffix}" for k in range(2)]
        for path in pictures:
            with picture(path) as figure:
                figure.subplots().plot(TIME, np.sin(TIME))
        first, second = (path.read_bytes() for path in pictures)
        assert first.startswith(start)
        assert first == second


def test_names_are_shown_as_they_are(tmp_path: Path) -> None:
    """Dollar signs in a name from outside do not make it a formula, which could even be a wrong one."""
    with picture(tmp_path / "a.svg") as figure:
        axes = figure.subplots()
        axes.plot(TIME, TIME, label=TEX)
        axes.set(title=TEX, xlabel=TEX)
        axes.legend()
    assert f"<!-- {TEX} -->" in (tmp_path / "a.svg").read_text(encoding="utf-8")
    shown = chart(TEX, TEX, TEX)
    for text in (shown.title.text, shown.xaxis.axis_label, shown.yaxis.axis_label):
        assert isinstance(text, PlainText)


def test_figures_that_are_shown_together_have_one_legend() -> None:
    """Each name has one entry, above the first figure with it, which hides what has the name in all of them."""
    figures = [chart(), chart()]
    for shown, names in zip(figures, (("a", None), ("a", "b")), strict=True):
        for name in names:
            shown.line(TIME, TIME, name=name)
    join(figures)
    first, second = (shown.legend[0].items for shown in figures)
    assert [(item.label.value, len(item.renderers)) for item in (*first, *second)] == [("a", 2), ("b", 1)]


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


MOST = 32_000  # points: 8000 columns


def extremes(x: np.ndarray, y: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the first, least, largest and last value between each two edges, shape (m, 4)."""
    parts = np.split(y, np.searchsorted(x, edges[1:-1]))
    return np.array([[part[0], part.min(), part.max(), part[-1]] for part in parts])


def test_each_column_keeps_its_extremes() -> None:
    """Of two million points at uneven times 32,000 are kept, among them the extremes and ends of 2000 columns."""
    random = np.random.default_rng(3)
    x = np.cumsum(0.01 + random.random(2_000_000, dtype=np.float32), dtype=np.float64)
    y = np.sin(x / 4e4) + 0.2 * random.standard_normal(len(x), dtype=np.float32)
    y[[1_234_567, 1_900_000]] = 9.0, -7.0
    rows = few_points(x, y, MOST)
    assert len(rows) <= MOST + 1
    assert np.all(np.diff(rows) > 0)
    edges = np.linspace(x[0], x[-1], 2001)
    np.testing.assert_array_equal(extremes(x[rows], y[rows], edges), extremes(x, y, edges))


def test_gaps_and_loops_stay() -> None:
    """A gap keeps its ends, a line that goes back its way, a short one all; of equal values the first is enough."""
    turns = np.linspace(0.0, 6.0 * np.pi, 1_000_000)
    x, y = np.cos(turns), np.sin(turns) * np.exp(-0.01 * turns)
    hole = (turns > 5.0) & (turns < 8.0)
    rows = few_points(turns, np.where(hole, np.nan, y), MOST)
    inside = np.flatnonzero(hole)
    assert rows[hole[rows]].tolist() == inside[[0, -1]].tolist()
    assert {inside[0] - 1, inside[-1] + 1} <= set(rows.tolist())
    back = few_points(x, y, MOST)
    assert len(back) < 200_000
    assert np.abs(np.diff(x[back])).max() < 1e-3  # of 2: beside each other in a column, or in the next
    assert len(few_points(turns, np.sign(np.sin(turns)), MOST)) < 17_000
    assert len(few_points(turns[:MOST], y[:MOST], MOST)) == MOST
    assert len(few_points(turns, np.full(len(turns), np.nan), MOST)) == 2


def test_a_page_thins_lines_by_their_axes() -> None:
    """Lines share the points of a page; over decades each decade keeps its own, and dots all of theirs."""
    decades = np.logspace(-6.0, 6.0, 200_000)
    shown = chart(x_axis_type="log", y_axis_type="log")
    line = shown.line(np.append(-1.0, decades), np.append(1.0, decades**2))
    dots = shown.scatter(decades, decades)
    thin([shown])
    x = line.data_source.data["x"]
    assert len(x) < 1.1 * MOST_POINTS
    assert np.diff(np.log10(x[1:])).max() < 0.01
    assert len(dots.data_source.data["x"]) == len(decades)
