"""Plots of curves with millions of points."""

from __future__ import annotations

import numpy as np
import pytest

from rx90_common.report.charts import MOST_POINTS, chart, thin
from rx90_common.report.few_points import few_points

pytestmark = pytest.mark.slow


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
