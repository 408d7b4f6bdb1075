"""Plots on the page: what follows the newest values, a loop, two runs along a line; all plots as files, too."""

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from viser import uplot

from rx90_common.base.arrays import Array
from rx90_common.process.files import write_text
from rx90_common.report.picture import write_picture
from rx90_common.report.plot import COLOURS, GREY, Curve, Panel, Plot
from rx90_emulator.loop.line import PathAccuracy
from rx90_emulator.view.page import FileFields, Page, block, from_user
from rx90_emulator.view.scene import LineScene

NO_POINTS = np.empty(0)
_EMPTY_X, _EMPTY_Y = np.array([0.0, 1.0]), np.array([np.nan, np.nan])  # of a plot without samples
_TIME = "time [s]"


def curves_of(names: Sequence[str]) -> list[Curve]:
    """Return curves without points, with these labels and the usual colours."""
    return [Curve(NO_POINTS, NO_POINTS, name, COLOURS[k % len(COLOURS)]) for k, name in enumerate(names)]


class Graph:
    """Curves over one abscissa, in the container that is being filled and, by its title, in the page's `panels`.

    uPlot draws a line across NaN, and finds no range for a column that begins with it. With `parts`, each curve is sent
    as so many columns, without a gap inside each, beside one that is not drawn and has what the ordinate must show.

    Args:
        page: to draw in.
        title: with the unit of the ordinate.
        curves: their labels, colours and dashes.
        x: label of the abscissa, with the unit.
        y: label of the ordinate, where the title is none.
        parts: of each curve, one more than it may have gaps; 0: it has none.
        always: what the ordinate shows at least: noise, as of an arm at rest, is flat, and ticks do not lie so close
            that uPlot, which has three digits behind the point, writes the same of each. None: as wide as the curves.
        height: pixels.
        legend: name the curves; a click on a name hides its curve.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        curves: Sequence[Curve],
        *,
        x: str = _TIME,
        y: str = "",
        parts: int = 0,
        always: tuple[float, float] | None = None,
        height: int = 165,
        legend: bool = False,
    ) -> None:
        self._curves, self._chosen = list(curves), {curve.label for curve in curves}
        self._x, self._y, self._parts = x, y or title, parts
        ends = {
            end: {"pad": 0.1 if limit else 0.0, "soft": limit, "mode": 1}
            for end, limit in zip(("min", "max"), always or (), strict=False)
        }
        page.panels[title] = self.panel
        series = self._series()
        self._plot = page.gui.add_uplot(
            (_EMPTY_X, *[_EMPTY_Y] * (len(series) - 1)),
            series,
            title=title,
            scales={"x": uplot.Scale(time=False)} | ({"y": uplot.Scale(range=ends)} if ends else {}),
            axes=(
                uplot.Axis(label=x, size=30, labelSize=18),
                uplot.Axis(label=y, size=40, labelSize=18) if y else uplot.Axis(size=56),
            ),
            legend=uplot.Legend(show=legend, live=False),
            padding=(0, 12, 0, 0),
            height=height,
        )

    def choose(self, labels: Collection[str]) -> None:
        """Show only the curves with these labels."""
        self._chosen = set(labels)
        self._plot.series = self._series()

    def show(self, x: Array, values: Sequence[Array]) -> None:
        """Show curves over x, (n,), each of that shape."""
        self._curves = [replace(curve, x=x, y=y) for curve, y in zip(self._curves, values, strict=True)]
        sent = values
        if self._parts:
            extent = np.full(len(x), 0.0)
            finite = np.concatenate([NO_POINTS, *(curve.y[np.isfinite(curve.y)] for curve in self._seen)])
            if len(finite):
                extent[:], extent[0] = finite.min(), finite.max()
            sent = [extent, *(part for y in values for part in _parts_of(y, self._parts))]
        self._plot.data = (x, *sent)

    def panel(self) -> Panel:
        """Return what is to be seen as a plot for a file."""
        return Panel(self._seen, "", self._x, self._y)

    @property
    def _seen(self) -> list[Curve]:
        return [curve for curve in self._curves if curve.label in self._chosen]

    def _series(self) -> tuple[uplot.Series, ...]:
        """Return how the columns are drawn: abscissa, what the ordinate must show, the parts of the curves."""
        series = [uplot.Series(label=self._x)]
        if self._parts:
            series.append(uplot.Series(label="extent", stroke="rgba(0,0,0,0)", points={"show": False}))
        for curve in self._curves:
            drawn = uplot.Series(
                label=curve.label, stroke=curve.colour, width=1.5, show=curve.label in self._chosen,
                auto=not self._parts, points={"show": False},
            )  # fmt: skip
            if curve.dash != "solid":
                drawn["dash"] = (6, 4)
            series += [drawn] * max(1, self._parts)
        return tuple(series)


def _parts_of(curve: Array, most: int) -> list[Array]:
    """Return a curve as `most` columns, each without a gap inside; of too many gaps the shortest are drawn across."""
    known = np.flatnonzero(np.isfinite(curve))
    jumps = np.flatnonzero(np.diff(known) > 1)
    jumps = np.sort(jumps[np.argsort(np.diff(known)[jumps], kind="stable")[::-1][: most - 1]])
    columns = [np.full(len(curve), np.nan) for _ in range(most)]
    for column, rows in zip(columns, np.split(known, jumps + 1), strict=False):
        column[rows] = curve[rows]
    return columns


WINDOW = 10.0  # s
_CAPACITY = 400  # samples in it


class RollingPlot(Graph):
    """Quantities against time, over the last WINDOW s of simulated time.

    Args:
        page: to draw in.
        title: with the unit, such as "friction torque [Nm]".
        names: of the quantities, in the order of the values.
        always: as in `Graph`.
        gaps: how many times in the window the quantities may be unknown (NaN) in between.
    """

    def __init__(
        self, page: Page, title: str, names: Sequence[str], always: tuple[float, float], *, gaps: int = 0
    ) -> None:
        parts = 1 + gaps if gaps else 0
        super().__init__(page, title, curves_of(names), parts=parts, always=always, legend=len(names) > 1)
        self._samples: deque[list[float]] = deque(maxlen=_CAPACITY)

    def add(self, time: float, values: ArrayLike) -> None:
        """Add the values (n,) at a time, s; a time before the last one clears the plot first."""
        if self._samples and time < self._samples[-1][0]:
            self._samples.clear()
        self._samples.append([time, *np.asarray(values, dtype=np.float64).tolist()])

    def draw(self) -> None:
        """Send what is to be seen."""
        if len(self._samples) > 1:
            samples = np.array(self._samples)
            time, *values = samples[samples[:, 0] >= samples[-1, 0] - WINDOW].T.copy()
            self.show(time, values)


_PIXELS = 300  # of a loop's width and height: what is closer cannot be seen
_LOOP_SAMPLES = 2000  # samples that are kept


class LoopPlot(Graph):
    """One quantity against another, the newest samples, as a loop.

    Args:
        page: to draw in.
        title: such as "friction against velocity".
        x: label of the abscissa, with the unit.
        y: label of the ordinate, with the unit.
        noise: of an arm at rest, x and y, which is not drawn.
    """

    def __init__(self, page: Page, title: str, x: str, y: str, noise: tuple[float, float]) -> None:
        super().__init__(page, title, curves_of([y]), x=x, y=y, always=(-noise[1], noise[1]), height=240)
        # A drag would show a part of the loop; it is drawn as if it were sorted, and has no part.
        self._plot.cursor = uplot.Cursor(drag=uplot.Cursor_Drag(x=False, y=False))
        self._noise, self._changed = np.array(noise), False
        self._samples = np.zeros((0, 2))

    def add(self, x: Array, y: Array) -> None:
        """Add samples, each of shape (n,), without those that lie on the one before them."""
        new = np.stack([x, y], axis=1)
        reach = np.maximum(np.ptp(np.concatenate([self._samples, new]), axis=0), self._noise) / _PIXELS
        kept, before = [self._samples], self._samples[-1] if len(self._samples) else np.full(2, np.inf)
        for sample in new:
            if (np.abs(sample - before) > reach).any():
                kept.append(sample[None])
                before = sample
        self._changed |= len(kept) > 1
        self._samples = np.concatenate(kept)[-_LOOP_SAMPLES:]

    def clear(self) -> None:
        """Forget all samples, and show none."""
        self._samples = self._samples[:0]
        self._plot.data = (_EMPTY_X, _EMPTY_Y)

    def draw(self) -> None:
        """Send what is to be seen."""
        if len(self._samples) > 1 and self._changed:
            self._changed = False
            self.show(*_as_if_sorted(*self._samples.T))

    def panel(self) -> Panel:
        """Return the samples as a plot for a file."""
        return Panel([Curve(*self._samples.T)], "", self._x, self._y)


def _as_if_sorted(x: Array, y: Array) -> tuple[Array, list[Array]]:
    """Return the curve, so that it begins at its least x and ends at its largest.

    uPlot looks for the samples within the axis by halving, as if x were sorted, and finds these two. From one end of
    the curve to its least x, and from the other end to its largest, the way leads along the curve itself.
    """
    first, last = int(np.argmin(x)), int(np.argmax(x))
    way = np.concatenate([np.arange(first, 0, -1), np.arange(len(x)), np.arange(len(x) - 2, last - 1, -1)])
    longer = np.append(x[way], x[last] + 1e-9 * (1.0 + float(np.ptp(x))))  # larger than any before it
    return longer, [np.append(y[way], y[last])]


_BINS = 300  # along the line, about one for each pixel
_FLAT_ERROR = 0.01  # mm
_ALONG = "along the line [mm]"
_WORDS = (
    "Hold a run, change something, and send the line again: both are drawn over the way, and their numbers stand here."
)


class RunComparison(Graph):
    """A plot of the path error over the way, two numbers of each run, and the trace that is held.

    Args:
        page: to build in, within a `plot_tab`.
    """

    def __init__(self, page: Page) -> None:
        self._runs: dict[str, PathAccuracy | None] = {"held": None, "newest": None}
        self._line: LineScene | None = None
        self._drawn: tuple[object, ...] = ()
        curves = [Curve(NO_POINTS, NO_POINTS, "held", GREY), Curve(NO_POINTS, NO_POINTS, "newest")]
        title = f"path error {_ALONG}"
        super().__init__(page, title, curves, x=_ALONG, parts=1, always=(0.0, _FLAT_ERROR), height=240)
        self._numbers = page.gui.add_html(block(_WORDS))
        self._hold = page.gui.add_button("Hold the newest run", disabled=True)
        self._release = page.gui.add_button("Let the held run go", visible=False)
        self._hold.on_click(from_user(partial(self._keep, wanted=True), page))
        self._release.on_click(from_user(partial(self._keep, wanted=False), page))

    def _keep(self, *, wanted: bool) -> None:
        """Keep the newest run, and its trace; or forget those that are kept."""
        self._runs["held"] = self._runs["newest"] if wanted else None
        self._release.visible = self._runs["held"] is not None
        if self._line is not None:
            self._line.hold(wanted=wanted)

    def draw(self, line: LineScene) -> None:
        """Draw the newest run along a line beside the one that is held, if anything has changed."""
        self._line, newest = line, line.run
        if self._runs["held"] is not None and not len(line.held):
            self._keep(wanted=False)  # of another line
        self._runs["newest"] = newest
        times = NO_POINTS if newest is None else newest.times[[0, -1]]
        shown = (self._runs["held"], *times.tolist())
        if shown == self._drawn:
            return
        self._drawn = shown
        self._hold.disabled = newest is None
        known = {name: run for name, run in self._runs.items() if run is not None}
        way = np.linspace(0.0, max((float(run.along.max()) for run in known.values()), default=1.0) * 1e3, _BINS)
        self.show(way, [_over(way, run) for run in self._runs.values()])
        rows = [("<b>path error</b>", "<b>largest, mm</b>", "<b>at, mm</b>", "<b>RMS, mm</b>")]
        for name, run in known.items():
            at = float(run.along[np.argmax(run.perpendicular)])
            rows.append((name, f"{run.worst * 1e3:.4f}", f"{at * 1e3:.0f}", f"{run.rms * 1e3:.4f}"))
        if len(known) > 1:
            held, second = known.values()
            rows.append(("newest / held", f"{second.worst / held.worst:.3f}", "", f"{second.rms / held.rms:.3f}"))
        lines = "".join(f"<tr>{''.join(f'<td>{word}</td>' for word in row)}</tr>" for row in rows)
        table = f'<table style="width:100%;text-align:left">{lines}</table>'
        self._numbers.content = block(table if known else _WORDS)

    def panel(self) -> Panel:
        """Return both runs, sample by sample, as a plot for a file."""
        curves = [
            replace(curve, x=run.along * 1e3, y=run.perpendicular * 1e3)
            for curve in self._curves
            if (run := self._runs[curve.label]) is not None
        ]
        return Panel(curves, "", _ALONG, "path error [mm]", from_zero=True)


def _over(way: Array, run: PathAccuracy | None) -> Array:
    """Return the largest path error at each place of the way, mm; NaN where the run has not come to, or is none."""
    largest = np.full(len(way), np.nan)
    if run is None:
        return largest
    place = np.clip(np.rint(run.along * 1e3 / way[-1] * (len(way) - 1)).astype(np.int64), 0, len(way) - 1)
    np.fmax.at(largest, place, run.perpendicular * 1e3)
    known = np.isfinite(largest)
    return np.asarray(np.interp(way, way[known], largest[known], right=np.nan))


_HEIGHT = 3.0  # inches


def add_plot_export(page: Page) -> None:
    """Add fields that write one of the page's plots as it is at that moment, within a tab, once all plots are there."""
    chosen = page.gui.add_dropdown("plot", tuple(page.panels))

    def write(path: Path) -> str:
        panel = page.panels[chosen.value]()
        if path.suffix == ".png":
            write_picture(Plot([panel], height=_HEIGHT), path)
        else:
            write_text(path, table(panel))
        return f"written: {path}"

    writers = {"Write the PNG": (".png", write), "Write the CSV": (".csv", write)}
    FileFields(page, "file, without .png or .csv", "plot", writers, "")


def table(panel: Panel) -> str:
    """Return the curves of a panel as CSV: the abscissa of the first, each ordinate, and each abscissa of its own.

    Numbers are read back to the bit; where there is none nothing stands.
    """
    columns: list[tuple[str, Array]] = []
    for curve in (curve for curve in panel.marks if isinstance(curve, Curve)):
        if not columns:
            columns.append((panel.x_label, curve.x))
        elif not np.array_equal(columns[0][1], curve.x):
            columns.append((f"{curve.label}: {panel.x_label}", curve.x))
        columns.append((f"{curve.label}: {panel.y_label}" if curve.label else panel.y_label, curve.y))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    texts = [["" if np.isnan(value) else repr(value) for value in values.tolist()] for _, values in columns]
    writer.writerows(zip_longest(*texts, fillvalue=""))
    return text.getvalue()
