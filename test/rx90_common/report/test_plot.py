"""Plots: what is drawn of curves, and how."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import interp1d

from rx90_common.report.live import plot_json
from rx90_common.report.plot import Band, Curve, Dots, Level, Panel, Plot, symlog
from rx90_common.report.simplifying import Extent, simplified
from rx90_common.report.still import as_svg, drawn, write_picture
from rx90_common.report.ticks import Axis, ticks_of

TIME = np.linspace(0.0, 8.0, 8001)
NOISE = np.random.default_rng(5).normal(size=len(TIME))


def panel(*marks: Curve | Dots | Band | Level, **options: object) -> Panel:
    """Return a panel with labels."""
    return Panel(marks, "a title", "time, s", "torque, Nm", **options)  # type: ignore[arg-type]


def decoded(stored: dict[str, Any]) -> np.ndarray:
    """Return numbers as they stand in a page."""
    return np.frombuffer(base64.b64decode(stored["data"]), "<f4").astype(np.float64) + stored["middle"]


def line_of(panel: Panel, curve: Curve, most: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a line of `most` points that looks like a curve, where such a one does."""
    line = simplified(panel, curve, most, most)
    assert isinstance(line, Curve)
    return line.x, line.y


def test_a_simplified_curve_is_the_curve() -> None:
    """A smooth curve needs few points; every sample lies within a dot of the line through them, on 4000 x 2000."""
    curve = Curve(TIME, np.sin(2.0 * TIME) * np.exp(-0.1 * TIME))
    scale = np.array([4000.0, 2000.0]) / (8.0, np.ptp(curve.y))
    kept = np.column_stack(line_of(panel(curve), curve)) * scale
    assert len(kept) < 500
    samples, steps = np.column_stack([curve.x, curve.y])[::10] * scale, np.diff(kept, axis=0)
    lengths = np.maximum((steps**2).sum(axis=1), 1e-12)
    offset = samples[:, None] - kept[:-1]
    share = np.clip((offset * steps).sum(axis=2) / lengths, 0.0, 1.0)
    assert np.linalg.norm(offset - share[..., None] * steps, axis=2).min(axis=1).max() < 1.0


def test_noise_and_gaps_stay() -> None:
    """Of noise that goes back in x as many points are kept as are allowed, with the extremes; a gap stays one."""
    values = np.where(np.abs(TIME - 4.0) < 0.5, np.nan, NOISE)
    curve = Curve(-TIME, values)
    x, y = line_of(panel(curve), curve, 2000)
    assert 500 < len(x) <= 2000
    assert (np.nanmax(y), np.nanmin(y)) == pytest.approx((np.nanmax(values), np.nanmin(values)), rel=2e-3)
    (gap,) = np.flatnonzero(np.isnan(y))
    assert (x[gap - 1], x[gap + 1]) == pytest.approx((-3.5, -4.5), abs=5e-3)


@pytest.mark.parametrize("x_scale", ["linear", "log"])
def test_a_vibration_is_drawn_as_the_area_that_it_covers(x_scale: str) -> None:
    """A line too dense for its points covers in each column what its amplitude says; peaks and gaps stay.

    The amplitude is 1 + 0.5 sin(0.7 t); in the middle of each column the area reaches from least to largest amplitude
    within it, to 1e-3, which is what is between two samples at a peak.
    """
    x = np.linspace(1.0, 9.0, 60_001)
    amplitude = 1.0 + 0.5 * np.sin(0.7 * x)
    y = amplitude * np.sin(5e3 * x)
    y[(x > 4.0) & (x < 5.0)] = np.nan
    y[12_345] = 7.0
    content = json.loads(plot_json(Plot([panel(Curve(x, y, "vibration"), x_scale=x_scale)]), 500))
    (mark,) = content["panels"][0]["marks"]
    columns = mark["columns"]
    assert (mark["kind"], columns["count"]) == ("extent", 500)
    edges = np.linspace(columns["first"], columns["last"], 501)
    edges = 10.0**edges if x_scale == "log" else edges
    ends = np.array([edges[:-1], edges[1:]])
    assert ends[[0, 1], [0, -1]] == pytest.approx([1.0, 9.0])
    low, high = decoded(mark["low"]), decoded(mark["high"])
    empty = (ends[0] > 4.0) & (ends[1] < 5.0)
    assert np.isnan(low[empty]).all()
    assert np.isfinite(low[~empty]).all()
    (peak,) = np.flatnonzero((ends[0] <= x[12_345]) & (x[12_345] < ends[1]))
    assert high[peak] == pytest.approx(7.0)
    whole = (ends[1] < 4.0) | (ends[0] > 5.0)
    whole[peak] = False
    fine = np.linspace(*ends[:, whole], 50)
    largest = (1.0 + 0.5 * np.sin(0.7 * fine)).max(axis=0)
    np.testing.assert_allclose([high[whole], -low[whole]], [largest, largest], atol=2e-2)


def test_a_step_between_samples_is_drawn() -> None:
    """Columns without a sample hold the line that passes through them, and a vertical line its whole height."""
    x = np.concatenate([np.linspace(0.0, 1.0, 3000), np.linspace(9.0, 10.0, 3000)])
    curve = Curve(x, np.concatenate([NOISE[:3000], 100.0 + NOISE[:3000]]))
    area = simplified(panel(curve), curve, 100, 100)
    assert isinstance(area, Extent)
    middles = 0.5 * (area.edges[:-1] + area.edges[1:])
    between = (middles > 1.0) & (middles < 9.0)
    slope = (100.0 + NOISE[0] - NOISE[2999]) / 8.0
    line = NOISE[2999] + slope * (middles[between] - 1.0)
    np.testing.assert_allclose(0.5 * (area.low + area.high)[between], line, rtol=1e-9)
    np.testing.assert_allclose((area.high - area.low)[between], 0.1 * slope, rtol=1e-9)


def test_on_logarithmic_axes_small_values_count_as_large_ones_do() -> None:
    """A curve over six decades keeps its shape in each of them; what is not positive is a gap."""
    x = np.logspace(-3.0, 3.0, 5000)
    curve = Curve(np.append(x, -1.0), np.append(x**-2.0 * (1.0 + 0.5 * np.sin(10.0 * np.log(x))), 1.0))
    found = np.log(line_of(panel(curve, x_scale="log", y_scale="log"), curve))
    assert len(found[0]) < 2000
    assert np.abs(interp1d(*found)(np.log(x)) - np.log(curve.y[:-1])).max() < 0.02


def test_numbers_in_the_page_keep_their_precision_far_from_zero() -> None:
    """What is zoomed is right to 1e-7 of its range, also a small motion about a large angle."""
    small = 1.5 + 1e-6 * NOISE[:100]
    content = json.loads(plot_json(Plot([panel(Dots(TIME[:100], small))])))
    assert np.abs(decoded(content["panels"][0]["marks"][0]["y"]) - small).max() < 1e-7 * np.ptp(small)


def test_ranges_hold_all_that_is_drawn() -> None:
    """Axes show curves, error bars, bands and levels with a margin, shared ones those of all panels."""
    marks = (
        Curve(np.array([1.0, 2.0]), np.array([0.0, 1.0])),
        Dots(np.array([3.0]), np.array([1.0]), error=np.array([4.0])),
        Band(np.array([0.0, 1.0]), np.array([-2.0, -9.0]), np.array([0.0, 1.0])),
        Level(7.0),
        Level(-1.0, upright=True),
    )
    one = panel(*marks)
    low, high = one.y_range
    assert -10.0 < low < -9.0
    assert 7.0 < high < 8.0
    assert one.x_range == pytest.approx((-1.12, 3.12))
    other = panel(Curve(np.array([0.0, 50.0]), np.array([0.0, 1.0])), from_zero=True)
    assert other.y_range[0] == 0.0
    assert Plot([one, other]).x_range == pytest.approx((-1.5, 51.5))
    assert panel(Curve(np.array([np.nan]), np.array([np.nan]))).x_range == (0.0, 1.0)


def test_a_curve_keeps_its_shape_on_a_logarithmic_axis() -> None:
    """What is straight over x is bent on an axis with decades of x: fewer points show the same there."""
    x = np.concatenate([-np.geomspace(1e-3, 1.0, 500)[::-1], np.geomspace(1e-3, 1.0, 500)])
    curve = Curve(x, 40.0 + 10.0 * x)
    few_x, few_y = line_of(panel(curve, x_scale="symlog", smallest=1e-3), curve)
    assert len(few_x) < 500
    shown = np.interp(symlog(x, 1e-3), symlog(few_x, 1e-3), few_y)
    assert shown == pytest.approx(curve.y, abs=20.0 / 2000)  # a dot of the canvas


def test_equal_plots_are_equal_bytes(tmp_path: Path) -> None:
    """Pictures of each format and the data to be zoomed hold no date, chance or counter."""

    def plot() -> Plot:
        x = np.array([-2.0, -0.1, 0.1, 1.0])
        return Plot([panel(Curve(x, x**2, "square"), Dots(x, x, "line", error=x**2), x_scale="symlog", smallest=0.1)])

    assert as_svg(plot()) == as_svg(plot())
    assert plot_json(plot()) == plot_json(plot())
    for suffix, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        pictures = [tmp_path / f"{k}{suffix}" for k in range(2)]
        for picture in pictures:
            write_picture(plot(), picture, "a title")
        first, second = (picture.read_bytes() for picture in pictures)
        assert first.startswith(start)
        assert first == second


@pytest.mark.parametrize("ends", [(-0.3, 8.2), (-1.2e5, 1.1e5), (1.0 - 1e-7, 1.0 + 1e-7), (3e-4, 4.5e-4)])
def test_ticks_are_those_of_matplotlibs_axes(ends: tuple[float, float]) -> None:
    """A linear axis has the ticks, labels and offset that matplotlib's own axis has there, each in its place."""
    axes = Figure().subplots()
    axes.set_xlim(*ends)
    axes.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]))
    axes.figure.draw_without_rendering()
    shown = [tick for tick in axes.get_xticks() if ends[0] <= tick <= ends[1]]
    named = {round(label.get_position()[0], 12): label.get_text() for label in axes.get_xticklabels()}
    axis = Axis("linear", ends, 1.0, 2.0, 5.0)
    found = ticks_of(axis, 8)
    assert found.values == pytest.approx(shown)
    assert list(found.labels) == [named[round(tick, 12)] for tick in shown]
    assert found.offset == axes.xaxis.get_offset_text().get_text()
    assert axis.place(found.values) == pytest.approx([2.0 + 5.0 * (t - ends[0]) / (ends[1] - ends[0]) for t in shown])


def test_logarithmic_ticks_are_decades_or_their_parts() -> None:
    """Over many decades each has a tick and nine parts, over few 1, 2 and 5 have one; places go by the logarithm."""
    many = ticks_of(Axis("log", (1e-3, 1e3), 1.0, 0.0, 6.0), 5)
    assert many.values == pytest.approx(10.0 ** np.arange(-3.0, 4.0))
    assert {f"{k}e{d}" for d in range(-3, 3) for k in range(2, 10)} <= {
        f"{t:.0e}".replace("e-0", "e-").replace("e+0", "e") for t in many.between
    }
    few = ticks_of(Axis("log", (1.0, 50.0), 1.0, 0.0, 6.0), 5)
    assert few.labels == ["1", "2", "5", "10", "20", "50"]
    assert Axis("log", (1e-3, 1e3), 1.0, 0.0, 6.0).place([1.0, 100.0, -1.0]) == pytest.approx(
        [3.0, 5.0, np.nan], nan_ok=True
    )


def test_names_are_written_as_they_are() -> None:
    """Dollar signs in a name from outside do not make it a formula, which could even be a wrong one."""
    assert "a$\\frac$b" in as_svg(Plot([panel(Curve(TIME[:2], NOISE[:2], r"a$\frac$b"))]))


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("count", [1, 3, 9])
@pytest.mark.parametrize("words", ["up", "no feed-forward, no integral, soft gains"])
def test_a_legend_covers_neither_title_nor_panel_nor_the_edge(count: int, words: str, columns: int) -> None:
    """Legends stand above their panel and beside or below its title, within the picture, whatever their length."""
    marks = [Curve(TIME[:2], NOISE[:2] + k, f"{words} {k}") for k in range(count)]
    figure = drawn(Plot([panel(*marks), panel(*marks[:-1]), panel(Dots(TIME[:2], NOISE[:2], words))], columns), 100)
    figure.draw_without_rendering()
    written = [(text.get_text(), text.get_window_extent()) for text in figure.findobj(Text)]
    frames = [line.get_clip_box() for line in figure.findobj(Line2D) if line.get_clip_box() is not None]
    legends = [box for said, box in written if said.startswith(words)]
    others = [box for said, box in written if not said.startswith(words)] + frames
    assert len(legends) >= count
    for k, box in enumerate(legends):
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1 + 1.0
        assert box.y1 <= figure.bbox.y1
        inside = box.padded(-1.0)  # letters touch neither what is above nor below their line
        assert not any(inside.overlaps(other) for other in [*others, *legends[:k]])
