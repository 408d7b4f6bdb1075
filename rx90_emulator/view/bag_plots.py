"""The plots of recordings: the whole length, and what was around the time that is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

import numpy as np
from viser import uplot

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.plot import COLOURS, Curve, Panel
from rx90_emulator.view.page import Page
from rx90_emulator.view.plots import add_plot, extent_series, parts_of
from rx90_emulator.view.recording import Recording
from rx90_emulator.view.track import Difference, Track, since

_ALL = "all joints"
_SPANS = ("0.02", "0.1", "0.5", "2", "10", "60")
_LEAST = {"[mm]": 0.01, "[mrad]": 0.01, "[rad]": 0.01, "[rad/s]": 0.02, "[Nm]": 1.0}
_HINT = "Each point of a plot is the least or largest value in its share of the width: no peak is left out."
_OF_THE_TIP = "#111111"
_SECOND = "dashed: the second bag"
_BUCKETS = 300  # about one for each pixel of a plot
_CURSOR = "#888888"
_MOST_PARTS = 8  # of a curve with gaps


class CurvesPlot:
    """A field of one track or of several, the second one's dashed, with a vertical line at the time that is shown.

    What is less than the eye is to see, as noise at rest, is flat, by the unit of the title.

    Args:
        page: to draw in, within a `plot_tab`.
        title: with the unit.
        tracks: at least one.
        field: that all of them have.
        origin_ns: where the abscissa is 0.
        scale: what values are multiplied by, to the unit of the plot.
    """

    def __init__(
        self, page: Page, title: str, tracks: Sequence[Track], field: str, origin_ns: int, scale: float = 1.0
    ) -> None:
        self._title, self._tracks, self._field, self._origin, self._scale = title, tracks, field, origin_ns, scale
        self._least = next((length for unit, length in _LEAST.items() if title.endswith(unit)), 1.0)
        self._curves = [  # label, colour, whether dashed
            (name, COLOURS[column % len(COLOURS)] if len(track.names) > 1 else _OF_THE_TIP, number > 0)
            for number, track in enumerate(tracks)
            for column, name in enumerate(track.names)
        ]
        self._chosen = [True] * len(self._curves)
        self._parts = min(_MOST_PARTS, 1 + max(len(track.gaps()) for track in tracks))
        self._drawn: tuple[int, int, int | None] = 0, 0, None  # beginning, end, and time that is shown, ns
        self._points: tuple[Array, list[Array]] = (np.zeros(0), [])
        self._plot = add_plot(page, title, self.panel, self._series(), height=185)

    def choose(self, wanted: Callable[[str], bool]) -> None:
        """Show those curves alone whose label `wanted` holds for; all, where it holds for none."""
        chosen = [wanted(label) for label, _, _ in self._curves]
        self._chosen = chosen if any(chosen) else [True] * len(chosen)
        self._plot.series = self._series()
        self._drawn = (*self._drawn[:2], None)

    def draw(self, begin_ns: int, end_ns: int, shown_ns: int) -> None:
        """Draw the span from `begin_ns` to `end_ns`, with the line at `shown_ns`, unless that is what was drawn."""
        if (begin_ns, end_ns, shown_ns) == self._drawn:
            return
        if (begin_ns, end_ns) != self._drawn[:2]:
            found = [track.envelope(self._field, begin_ns, end_ns, _BUCKETS) for track in self._tracks]
            columns = [self._scale * column for _, values in found for column in values.T]
            self._points = (found[0][0] - self._origin) / NANOSECONDS, columns
        self._drawn = begin_ns, end_ns, shown_ns
        time, values = self._points
        finite = np.concatenate([v[np.isfinite(v)] for v, chosen in zip(values, self._chosen, strict=True) if chosen])
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
        short = max(0.0, self._least - (high - low)) / 2.0
        low, high = low - short, high + short
        shown = since(shown_ns, self._origin)
        place = int(np.searchsorted(time, shown))
        line, extent = np.full(len(time) + 2, np.nan), np.full(len(time) + 2, low)
        line[place : place + 2] = extent[:2] = low, high
        columns = [
            np.insert(part, place, [np.interp(shown, time, part)] * 2)
            for curve in values
            for part in parts_of(curve, self._parts)
        ]
        self._plot.data = (np.insert(time, place, [shown, shown]), extent, *columns, line)

    def panel(self) -> Panel:
        """Return what is to be seen as a plot for a file: the least and the largest values of each pixel's time."""
        time, values = self._points
        marks = [
            Curve(time, value, f"{label}{' (second bag)' * dashed}", color, 1.0, "dashed" if dashed else "solid")
            for (label, color, dashed), value, chosen in zip(self._curves, values, self._chosen, strict=False)
            if chosen
        ]
        return Panel(marks, "", "time [s]", self._title)

    def _series(self) -> tuple[uplot.Series, ...]:
        """Return how the columns are drawn: time, what the ordinate must show, the parts of each curve, and the line.

        uPlot draws a line across NaN, hence the parts.
        """
        lines = []
        for (label, color, dashed), chosen in zip(self._curves, self._chosen, strict=True):
            series = uplot.Series(label=label, stroke=color, width=1.5, show=chosen, auto=False, points={"show": False})
            if dashed:
                series["dash"] = (6, 4)
            lines += [series] * self._parts
        shown = uplot.Series(label="shown", stroke=_CURSOR, width=1.0, auto=False, points={"show": False})
        return (uplot.Series(label="time [s]"), extent_series(), *lines, shown)


class BagPlots:
    """Plots of one recording, or of two and their difference.

    Args:
        page: to draw in.
        recordings: one or two, on one time.
        difference: of two.
        path_errors: distance from the set-points' path, for each recording that has set-points.
        span_ns: beginning and end of all.
    """

    def __init__(
        self,
        page: Page,
        recordings: Sequence[Recording],
        difference: Difference | None,
        path_errors: Sequence[Track],
        span_ns: tuple[int, int],
    ) -> None:
        self._span = span_ns
        arms = [recording.arm for recording in recordings]
        frictions = [recording.friction for recording in recordings if recording.friction is not None]

        def plots(*wanted: tuple[str, Sequence[Track], str, float]) -> list[CurvesPlot]:
            made = []
            for title, tracks, field, scale in wanted:
                held = [track for track in tracks if field in track.values]
                if held:
                    made.append(CurvesPlot(page, title, held, field, span_ns[0], scale))
            return made

        legend = _legend(arms[0] if recordings[0].friction is None else recordings[0].friction, len(arms))

        with page.plot_tab("Whole length"):
            page.gui.add_html(legend)
            self._whole = plots(
                ("distance of the tips [mm]", [] if difference is None else [difference.tip], "position", 1e3),
                ("difference of the joints [mrad]", [] if difference is None else [difference.joints], "position", 1e3),
                ("path error at the tip [mm]", path_errors, "position", 1e3),
                ("joint angles [rad]", arms, "position", 1.0),
            )
            page.gui.add_markdown(_HINT)
        units = sorted({unit for arm in arms if (unit := arm.units.get("effort", "Nm")) != "Nm"})
        with page.plot_tab("Around the time"):
            page.gui.add_html(legend)
            joint = page.gui.add_dropdown("joint", (_ALL, *arms[0].names), initial_value=_ALL)
            self._width = page.gui.add_dropdown("width, s", _SPANS, initial_value="2")
            self._around = plots(
                (f"effort [{' and '.join(units)}]" if units else "drive torque [Nm]", arms, "effort", 1.0),
                ("friction torque [Nm]", frictions, "effort", 1.0),
                ("velocity [rad/s]", arms, "velocity", 1.0),
                ("position [rad]", arms, "position", 1.0),
            )

        def choose() -> None:
            for plot in self._around:
                plot.choose(lambda name: joint.value in (_ALL, name))

        joint.on_update(lambda _: page.later(choose))

    def draw_whole(self, shown_ns: int) -> None:
        """Show a time in the plots of the whole length, if it is another one than before."""
        for plot in self._whole:
            plot.draw(*self._span, shown_ns)

    def draw_around(self, shown_ns: int) -> None:
        """Draw what was around a time, if it is another one than before, or the width is."""
        half = round(float(self._width.value) * NANOSECONDS / 2)
        for plot in self._around:
            plot.draw(shown_ns - half, shown_ns + half, shown_ns)


def _legend(track: Track, bags: int) -> str:
    """Return the colours of joints and friction elements, as HTML."""
    parts = [
        f'<span style="color:{COLOURS[number % len(COLOURS)]}">&#9632;</span>&nbsp;{escape(name)}'
        for number, name in enumerate(track.names)
    ]
    text = " ".join([*parts, *[f"({_SECOND})"] * (bags - 1)])
    return f'<div style="padding:0.4em 0.8em 0;font-size:0.8em">{text}</div>'
