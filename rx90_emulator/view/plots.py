"""Plots that follow the newest values, two runs compared along a line, and plots as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import viser
from numpy.typing import ArrayLike
from viser import uplot

from rx90_common.base.arrays import Array
from rx90_common.process.files import write_text
from rx90_common.report.picture import write_picture
from rx90_common.report.plot import COLOURS, GREY, Curve, Panel, Plot
from rx90_emulator.loop.line import PathAccuracy
from rx90_emulator.view.page import FileFields, Page, block, from_user
from rx90_emulator.view.scene import LineScene

_PLACES = 300  # along the line, about one for each pixel
_FLAT_ERROR = 0.01  # mm
_TITLE = "path error along the line [mm]"
_ALONG = "along the line [mm]"
_WORDS = (
    "Hold a run, change something, and send the line again: both are drawn over the way, and their numbers stand here."
)

_MIN_SAMPLES = 2  # samples that make a plot
_PIXELS = 300  # of a loop's width and height: what is closer cannot be seen
_NOTHING = np.array([0.0, 1.0]), np.array([np.nan, np.nan])
"""Abscissa and ordinate of a plot that is empty."""


def ordinate(least: float, low: float | None = None) -> dict[str, uplot.Scale]:
    """Return scales whose ordinate shows -`least` to `least`, or `low` to `least`, and all curves.

    What is less than the eye is to see, as the noise of an arm at rest, is flat, and ticks do not lie so close that
    uPlot, which has three digits behind the point, writes the same of each.
    """
    soft = {"min": -least if low is None else low, "max": least}
    ends = {end: {"pad": 0.1 if limit else 0.0, "soft": limit, "mode": 1} for end, limit in soft.items()}
    return {"x": uplot.Scale(time=False), "y": uplot.Scale(range=ends)}


def add_plot(
    page: Page,
    title: str,
    panel: Callable[[], Panel],
    series: Sequence[uplot.Series],
    *,
    x: str = "time [s]",
    y: uplot.Axis | None = None,
    scales: dict[str, uplot.Scale] | None = None,
    height: int,
    legend: bool = False,
    zoom: bool = True,
) -> viser.GuiUplotHandle:
    """Add an empty plot to the container that is being filled.

    Args:
        page: to draw in; its `panels` get the plot, for files.
        title: with the unit of the ordinate.
        panel: returns what is to be seen.
        series: how its columns are drawn, the abscissa's first.
        x: label of the abscissa, with the unit.
        y: the ordinate's axis; by default one without a label.
        scales: of both axes; by default as wide as the curves.
        height: pixels.
        legend: name the curves; a click on a name hides its curve.
        zoom: whether a drag shows a part of it.
    """
    page.panels[title] = panel
    return page.gui.add_uplot(
        (_NOTHING[0], *[_NOTHING[1]] * (len(series) - 1)),
        tuple(series),
        title=title,
        scales=scales or {"x": uplot.Scale(time=False)},
        axes=(uplot.Axis(label=x, size=30, labelSize=18), y or uplot.Axis(size=56)),
        legend=uplot.Legend(show=legend, live=False),
        cursor=None if zoom else uplot.Cursor(drag=uplot.Cursor_Drag(x=False, y=False)),
        padding=(0, 12, 0, 0),
        height=height,
    )


class RollingPlot:
    """Quantities of several joints against time, over the last `window` s.

    Samples are kept in memory of a fixed size; `draw` sends those of the chosen joints.

    Args:
        page: to draw in, within a `plot_tab` or another container.
        title: with the unit, such as "friction torque [Nm]".
        names: of the joints, in the order of the values.
        window: s.
        capacity: samples in the window.
        height: pixels.
        legend: name the curves; a click on a name hides its curve.
        gaps: how many times in the window the quantities may be unknown (NaN) in between.
        least: what the ordinate shows at least, on either side of 0.
        low: its lower end at most, in place of -`least`.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        names: Sequence[str],
        *,
        window: float = 10.0,
        capacity: int = 400,
        height: int = 165,
        legend: bool = True,
        gaps: int = 0,
        least: float = 1.0,
        low: float | None = None,
    ) -> None:
        self._names, self._window, self._parts = tuple(names), window, 1 + gaps
        self._samples = np.full((capacity, 1 + len(self._names)), np.nan)
        self._count, self._title = 0, title
        self._shown = frozenset(range(len(self._names)))
        self._plot = add_plot(
            page, title, self.panel, self._series(), scales=ordinate(least, low), height=height, legend=legend
        )

    def choose(self, shown: Sequence[int]) -> None:
        """Show only these joints, by their indices."""
        self._shown = frozenset(shown)
        self._plot.series = self._series()

    def add(self, time: float, values: ArrayLike) -> None:
        """Add the values (n,) at a time, s; a time before the last one begins anew."""
        if self._count and time < self._samples[self._count - 1, 0]:
            self._count = 0
        if self._count == len(self._samples):
            self._samples[:-1] = self._samples[1:]
            self._count -= 1
        self._samples[self._count, 0], self._samples[self._count, 1:] = time, values
        self._count += 1

    def draw(self) -> None:
        """Send what is to be seen."""
        if self._count < _MIN_SAMPLES:
            return
        kept = self._in_window()
        time, *curves = kept.T
        if self._parts > 1:
            curves = [_extent(kept[:, 1:]), *(part for curve in curves for part in parts_of(curve, self._parts))]
        self._plot.data = (time.copy(), *(curve.copy() for curve in curves))

    def panel(self) -> Panel:
        """Return what is to be seen as a plot for a file."""
        time, *curves = self._in_window().T
        shown = [Curve(time, curves[k], self._names[k], COLOURS[k % len(COLOURS)]) for k in sorted(self._shown)]
        return Panel(shown, "", "time [s]", self._title)

    def _in_window(self) -> Array:
        kept = self._samples[: self._count]
        return kept[kept[:, 0] >= kept[-1, 0] - self._window] if len(kept) else kept

    def _series(self) -> tuple[uplot.Series, ...]:
        curves = [
            uplot.Series(label=name, stroke=COLOURS[index % len(COLOURS)], width=1.5, show=index in self._shown)
            for index, name in enumerate(self._names)
        ]
        if self._parts > 1:
            for curve in curves:
                curve["auto"] = False
            curves = [extent_series(), *(curve for curve in curves for _ in range(self._parts))]
        return (uplot.Series(label="time [s]"), *curves)


class LoopPlot:
    """One quantity against another, the newest `capacity` samples, as a loop.

    Args:
        page: to draw in.
        title: such as "friction against velocity".
        x: label of the abscissa, with the unit.
        y: label of the ordinate, with the unit.
        capacity: samples that are kept.
        height: pixels.
        least: what is drawn of the noise of an arm at rest, x and y: nothing.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        x: str,
        y: str,
        *,
        capacity: int = 2000,
        height: int = 240,
        least: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self._samples = np.zeros((0, 2))
        self._least, self._changed = np.array(least), False
        self._capacity = capacity
        self._plot = add_plot(
            page,
            title,
            lambda: Panel([Curve(*self._samples.T)], "", x, y),
            (uplot.Series(label=x), uplot.Series(label=y, stroke=COLOURS[0], width=1.5)),
            x=x,
            y=uplot.Axis(label=y, size=40, labelSize=18),
            scales=ordinate(least[1]),
            height=height,
            zoom=False,
        )

    def add(self, x: Array, y: Array) -> None:
        """Add samples, each of shape (n,), without those that lie on the one before them."""
        new = np.stack([x, y], axis=1)
        if not len(new):
            return
        reach = np.maximum(np.ptp(np.concatenate([self._samples, new]), axis=0), self._least) / _PIXELS
        kept, before = [], self._samples[-1] if len(self._samples) else np.full(2, np.inf)
        for sample in new:
            if (np.abs(sample - before) > reach).any():
                kept.append(sample)
                before = sample
        if kept:
            self._samples, self._changed = np.concatenate([self._samples, kept])[-self._capacity :], True

    def clear(self) -> None:
        """Forget all samples, and show none."""
        self._samples = self._samples[:0]
        self._plot.data = _NOTHING

    def draw(self) -> None:
        """Send what is to be seen."""
        if len(self._samples) < _MIN_SAMPLES or not self._changed:
            return
        self._changed = False
        x, y = self._samples.T
        self._plot.data = _as_if_sorted(x, y)


def _as_if_sorted(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the curve, so that it begins at its least x and ends at its largest.

    uPlot looks for the samples within the axis by halving, as if x were sorted, and finds these two. From one end of
    the curve to its least x, and from the other end to its largest, the way leads along the curve itself.
    """
    first, last = int(np.argmin(x)), int(np.argmax(x))
    way = np.concatenate([np.arange(first, 0, -1), np.arange(len(x)), np.arange(len(x) - 2, last - 1, -1)])
    longer = np.append(x[way], x[last] + 1e-9 * (1.0 + float(np.ptp(x))))  # larger than any before it
    return longer, np.append(y[way], y[last])


def extent_series() -> uplot.Series:
    """Return a curve that is not drawn and has all values that the ordinate must show.

    uPlot finds no range for a column that begins with NaN.
    """
    return uplot.Series(label="extent", stroke="rgba(0,0,0,0)", points={"show": False})


def _extent(values: Array) -> Array:
    """Return such a column for values (n, k); for none at all that of 0."""
    finite = values[np.isfinite(values)]
    column = np.full(len(values), finite.min() if len(finite) else 0.0)
    column[0] = finite.max() if len(finite) else 0.0
    return column


def parts_of(curve: Array, most: int) -> list[Array]:
    """Return a curve as `most` columns, each without a gap inside; of too many gaps the shortest are drawn across."""
    known = np.flatnonzero(np.isfinite(curve))
    jumps = np.flatnonzero(np.diff(known) > 1)
    jumps = np.sort(jumps[np.argsort(np.diff(known)[jumps], kind="stable")[::-1][: most - 1]])
    columns = [np.full(len(curve), np.nan) for _ in range(most)]
    for column, rows in zip(columns, np.split(known, jumps + 1), strict=False):
        column[rows] = curve[rows]
    return columns


_HEIGHT = 3.0  # inches


def add_plot_export(page: Page) -> None:
    """Add fields that write one of the page's plots as it is at that moment, within a tab, once all plots are there."""
    chosen = page.gui.add_dropdown("plot", tuple(page.panels))

    def picture(path: Path) -> str:
        write_picture(Plot([page.panels[chosen.value]()], height=_HEIGHT), path)
        return f"written: {path}"

    def numbers(path: Path) -> str:
        write_text(path, table(page.panels[chosen.value]()))
        return f"written: {path}"

    writers = {"Write the PNG": (".png", picture), "Write the CSV": (".csv", numbers)}
    FileFields(page, "file, without .png or .csv", "plot", writers, "")


def table(panel: Panel) -> str:
    """Return the curves of a panel as CSV: the abscissa of the first, each ordinate, and each abscissa of its own."""
    columns: list[tuple[str, list[str]]] = []
    first = None
    for curve in panel.marks:
        if not isinstance(curve, Curve):
            continue
        if first is None or not np.array_equal(first, curve.x):
            columns.append((panel.x_label if first is None else f"{curve.label}: {panel.x_label}", _texts(curve.x)))
        first = curve.x if first is None else first
        columns.append((f"{curve.label}: {panel.y_label}" if curve.label else panel.y_label, _texts(curve.y)))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    writer.writerows(zip_longest(*(values for _, values in columns), fillvalue=""))
    return text.getvalue()


def _texts(values: Array) -> list[str]:
    """Return numbers so that they are read back to the bit; nothing where there is none."""
    return ["" if np.isnan(value) else repr(float(value)) for value in values]


class RunComparison:
    """A plot of the path error over the way, two numbers of each run, and the trace that is held.

    Args:
        page: to build in.
    """

    def __init__(self, page: Page) -> None:
        self._newest: PathAccuracy | None = None
        self._held: PathAccuracy | None = None
        self._line: LineScene | None = None
        self._drawn: tuple[object, ...] = ()
        with page.plot_tab("Path"):
            series = uplot.Series(label="held", stroke=GREY, width=1.5, auto=False)
            newest = uplot.Series(label="newest", stroke=COLOURS[0], width=1.5, auto=False)
            columns = (uplot.Series(label=_ALONG), extent_series(), series, newest)
            scales = ordinate(_FLAT_ERROR, 0.0)
            self._plot = add_plot(page, _TITLE, self.panel, columns, x=_ALONG, scales=scales, height=240)
            self._plot.data = (np.array([0.0, 1.0]), np.zeros(2), *[np.full(2, np.nan)] * 2)
            self._numbers = page.gui.add_html(block(_WORDS))
            self._hold = page.gui.add_button("Hold the newest run", disabled=True)
            self._release = page.gui.add_button("Let the held run go", visible=False)
        self._hold.on_click(from_user(self.hold, page))
        self._release.on_click(from_user(self.release, page))

    def hold(self) -> None:
        """Keep the newest run, and its trace."""
        self._held = self._newest
        if self._line is not None:
            self._line.hold()
        self._release.visible = self._held is not None

    def release(self) -> None:
        """Forget the run that is held."""
        self._held, self._release.visible = None, False
        if self._line is not None:
            self._line.release()

    def draw(self, line: LineScene) -> None:
        """Draw the newest run along a line beside the one that is held, if anything has changed."""
        if self._held is not None and not line.holds:
            self.release()  # of another line
        self._line, self._newest = line, line.meter.run
        times = np.empty(0) if self._newest is None else self._newest.times[[0, -1]]
        shown = (self._held, *times.tolist(), line.meter)
        if shown == self._drawn:
            return
        self._drawn = shown
        self._hold.disabled = self._newest is None
        runs = [run for run in (self._held, self._newest) if run is not None]
        length = max((float(run.along.max()) for run in runs), default=1.0)
        way = np.linspace(0.0, length * 1e3, _PLACES)
        curves = [_over(way, run) for run in (self._held, self._newest)]
        extent = np.zeros(_PLACES)
        extent[0] = max((run.worst * 1e3 for run in runs), default=0.0)
        self._plot.data = (way, extent, *curves)
        self._numbers.content = block(_comparison(self._held, self._newest) if runs else _WORDS)

    def panel(self) -> Panel:
        """Return both runs, sample by sample, as a plot for a file."""
        both = (("held", self._held, GREY), ("newest", self._newest, COLOURS[0]))
        curves = [
            Curve(run.along * 1e3, run.perpendicular * 1e3, name, colour)
            for name, run, colour in both
            if run is not None
        ]
        return Panel(curves, "", _ALONG, "path error [mm]", from_zero=True)


def _over(way: Array, run: PathAccuracy | None) -> Array:
    """Return the largest path error at each place of the way, mm; NaN where the run has not come to, or is none."""
    if run is None:
        return np.full(len(way), np.nan)
    place = np.clip(np.rint(run.along * 1e3 / way[-1] * (len(way) - 1)).astype(np.int64), 0, len(way) - 1)
    largest = np.full(len(way), np.nan)
    np.fmax.at(largest, place, run.perpendicular * 1e3)
    known = np.isfinite(largest)
    return np.asarray(np.interp(way, way[known], largest[known], right=np.nan))


def _comparison(held: PathAccuracy | None, newest: PathAccuracy | None) -> str:
    rows = []
    for name, run in (("held", held), ("newest", newest)):
        if run is not None:
            at = float(run.along[np.argmax(run.perpendicular)])
            rows.append((name, f"{run.worst * 1e3:.4f}", f"{at * 1e3:.0f}", f"{run.rms * 1e3:.4f}"))
    if held is not None and newest is not None:
        rows.append(("newest / held", f"{newest.worst / held.worst:.3f}", "", f"{newest.rms / held.rms:.3f}"))
    head = "".join(f"<th>{word}</th>" for word in ("path error", "largest, mm", "at, mm", "RMS, mm"))
    cells = ("".join(f"<td>{word}</td>" for word in row) for row in rows)
    lines = "".join(f"<tr>{row}</tr>" for row in cells)
    return f'<table style="width:100%;text-align:left"><tr>{head}</tr>{lines}</table>'
