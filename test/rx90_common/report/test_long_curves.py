"""Plots of curves with millions of points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rx90_common.base.arrays import least_and_largest
from rx90_common.report.plot import Curve, Panel, Plot, with_fewer_points

pytestmark = pytest.mark.slow


def thinned(plot: Plot) -> Plot:
    """Return the plot with 8000 columns of each curve."""
    return with_fewer_points(plot, 32_000)


def only_curve(plot: Plot) -> tuple[Panel, Curve]:
    """Return a plot's panel and the curve in it."""
    (panel,) = plot.panels
    assert isinstance(panel, Panel)
    (curve,) = panel.marks
    assert isinstance(curve, Curve)
    return panel, curve


def extremes(x: np.ndarray, y: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the first, least, largest and last value between each two edges, shape (m, 4)."""
    parts = np.split(y, np.searchsorted(x, edges[1:-1]))
    return np.array([[part[0], part.min(), part.max(), part[-1]] for part in parts])


def test_each_column_keeps_its_extremes() -> None:
    """Of five million points at uneven times 32,000 are kept, among them the extremes and ends of 2000 columns."""
    random = np.random.default_rng(3)
    x = np.cumsum(0.01 + random.random(5_000_000, dtype=np.float32), dtype=np.float64)
    y = np.sin(x / 1e5) + 0.2 * random.standard_normal(len(x), dtype=np.float32)
    y[[1_234_567, 4_000_000]] = 9.0, -7.0
    _, kept = only_curve(thinned(Plot([Panel([Curve(x, y)])])))
    assert len(kept.x) <= 32_001
    assert np.array_equal(kept.y, y[np.searchsorted(x, kept.x)])
    edges = np.linspace(x[0], x[-1], 2001)
    np.testing.assert_array_equal(extremes(kept.x, kept.y, edges), extremes(x, y, edges))


def test_gaps_loops_and_decades_stay() -> None:
    """A gap keeps its ends, a curve that goes back its way, one over decades its points in each, and dots stay."""
    turns = np.linspace(0.0, 6.0 * np.pi, 1_000_000)
    loops = np.cos(turns), np.sin(turns) * np.exp(-0.01 * turns)
    holed = np.where((turns > 5.0) & (turns < 8.0), np.nan, loops[1])
    few = only_curve(thinned(Plot([Panel([Curve(turns, holed)])])))[1]
    empty = np.flatnonzero(np.isnan(few.y))
    assert np.array_equal(few.x[empty], turns[np.isnan(holed)][[0, -1]])
    assert np.array_equal(few.x[[empty[0] - 1, empty[-1] + 1]], [turns[turns <= 5.0][-1], turns[turns >= 8.0][0]])
    back = only_curve(thinned(Plot([Panel([Curve(*loops)])])))[1]
    rows = np.flatnonzero(np.isin(loops[1], back.y))
    assert np.array_equal(loops[1][rows], back.y)  # in the order of the way
    assert len(rows) < 200_000
    assert np.abs(np.diff(loops[0][rows])).max() < 1e-3  # of 2: beside each other in a column, or in the next
    decades = np.logspace(-6.0, 6.0, 200_000)
    panel = Panel([Curve(np.append(-1.0, decades), np.append(1.0, decades**2))], x_scale="log", y_scale="log")
    spread = only_curve(thinned(Plot([panel])))[1]
    assert len(spread.x) < 33_000
    assert np.diff(np.log10(spread.x[1:])).max() < 0.01
    steps = only_curve(thinned(Plot([Panel([Curve(turns, np.sign(np.sin(turns)))])])))[1]
    assert len(steps.x) < 17_000  # of equal values the first one is enough
    dots = Curve(turns, np.sin(turns), dots=True)  # each of which is drawn
    assert len(only_curve(thinned(Plot([Panel([dots])])))[1].x) == len(turns)
    nothing = only_curve(thinned(Plot([Panel([Curve(turns, np.full(len(turns), np.nan))])])))[1]
    assert len(nothing.x) == 2


def test_the_extremes_of_rows_leave_out_what_is_no_number() -> None:
    """Each group gives what NumPy finds in its rows without NaN, NaN for a group without any number."""
    random = np.random.default_rng(4)
    values = np.where(random.random((60, 2)) < 0.4, np.nan, random.standard_normal((60, 2)))
    starts = np.array([0, 1, 5, 20, 24, 59])
    values[20:24] = np.nan
    least, largest = least_and_largest(values, starts)
    for k, rows in enumerate(np.split(values, starts[1:])):
        for column in range(2):
            known = sorted(value for value in rows[:, column] if math.isfinite(value))
            ends = (known[0], known[-1]) if known else (np.nan, np.nan)
            np.testing.assert_array_equal((least[k, column], largest[k, column]), ends)
