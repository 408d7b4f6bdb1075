"""Figures of the pages: tables from what was measured, and the published curves over load and temperature."""

import re

import numpy as np
import pytest

from benchmarks import published_friction as paper
from benchmarks.figures import MEASURED, add, as_text, pages, read, tables, with_figures


def test_pages_hold_what_is_generated() -> None:
    """README.md and docs/ equal what `python -m benchmarks.figures` writes; each table stands in one of them."""
    measured = read(MEASURED)
    contents = {page: page.read_text(encoding="utf-8") for page in pages()}
    for page, content in contents.items():
        assert content == with_figures(content, measured), f"{page.name}: run python -m benchmarks.figures"
    placed = re.findall(r"<!-- figures: (\w+) -->\n\|", "\n".join(contents.values()))
    assert sorted(placed) == sorted(tables())
    assert MEASURED.read_text(encoding="utf-8") == as_text(add(measured, {}))


def test_an_element_repeats_load_and_temperature() -> None:
    """For every load and temperature, each and together, the element's curve is the paper's."""
    for load in paper.LOADS:
        for temperature in paper.TEMPERATURES:
            assert paper.error(load, temperature) < 1e-13


def test_figures_of_the_page_are_those_of_the_model() -> None:
    """What docs/ states follows from the equation, worked out here again at the limits of low and high speed."""
    known = read(MEASURED)
    for name, value in paper.trends().items():
        assert known[name] == [pytest.approx(value, rel=1e-3, abs=1e-13)]
    v, t = 200.0, np.array([30.0, 80.0])
    viscous = (1.3e-4 + 1.32e-3 * np.exp(-t / 20.71)) * v
    stribeck = (-0.025 + 0.0016 * t) * np.exp(-((v / (-24.81 + 0.98 * t)) ** 1.36))
    cold, hot = 0.0311 + viscous + stribeck
    assert known["published_friction_hot_fast"] == [pytest.approx(hot / cold, rel=1e-3)]
