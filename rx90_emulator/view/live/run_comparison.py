"""Before and after: a run along the line that is held, and the newest one beside it."""

from __future__ import annotations

import numpy as np
from viser import uplot

from rx90_common.base.arrays import Array
from rx90_common.report.plot import COLOURS, GREY, Curve, Panel
from rx90_emulator.loop.line import PathAccuracy
from rx90_emulator.view.changes import from_user
from rx90_emulator.view.line import LineScene
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import extent_series, ordinate
from rx90_emulator.view.widgets import block

_PLACES = 300  # along the line, about one for each pixel
_LEAST = 0.01  # mm
_TITLE = "path error along the line [mm]"
_ALONG = "along the line [mm]"
_WORDS = (
    "Hold a run, change something, and send the line again: both are drawn over the way, and their numbers stand here."
)


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
            self._plot = page.gui.add_uplot(
                (np.array([0.0, 1.0]), np.zeros(2), *[np.full(2, np.nan)] * 2),
                (uplot.Series(label=_ALONG), extent_series(), series, newest),
                title=_TITLE,
                scales=ordinate(_LEAST, 0.0),
                axes=(uplot.Axis(label=_ALONG, size=30, labelSize=18), uplot.Axis(size=56)),
                legend=uplot.Legend(show=False),
                padding=(0, 12, 0, 0),
                height=240,
            )
            self._numbers = page.gui.add_html(block(_WORDS))
            self._hold = page.gui.add_button("Hold the newest run", disabled=True)
            self._release = page.gui.add_button("Let the held run go", visible=False)
        page.panels[_TITLE] = self.panel
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
        self._numbers.content = block(_table(self._held, self._newest) if runs else _WORDS)

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


def _table(held: PathAccuracy | None, newest: PathAccuracy | None) -> str:
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
