"""The plots of recordings: the whole length, and what was around the time that is shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import NamedTuple

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
_MM, _MRAD = 1e3, 1e3
_LEAST = {"[mm]": 0.01, "[mrad]": 0.01, "[rad]": 0.01, "[rad/s]": 0.02, "[Nm]": 1.0}
_HINT = "Each point of a plot is the least or largest value in its share of the width: no peak is left out."
_OF_THE_TIP = "#111111"
_SECOND = "dashed: the second bag"
_BUCKETS = 300  # about one for each pixel of a plot
_CURSOR = "#888888"
_MOST_PARTS = 8  # of a curve with gaps


class RecordedCurve(NamedTuple):
    """One column of a field of a track.

    Attributes:
        label: in the plot's legend and for `choose`.
        track: with the values.
        field: of the track.
        column: of the field.
        scale: what values are multiplied by, to the unit of the plot.
        color: as #rrggbb.
        dashed: for the second recording.
    """

    label: str
    track: Track
    field: str
    column: int
    scale: float
    color: str
    dashed: bool = False


class CurvesPlot:
    """Curves over a span of time, with a vertical line at the time that is shown.

    Args:
        page: to draw in, within a `plot_tab`.
        title: with the unit.
        curves: at least one.
        origin_ns: where the abscissa is 0.
        least: length of the ordinate; what is less than the eye is to see, as noise at rest, is flat.
        height: pixels.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        curves: Sequence[RecordedCurve],
        origin_ns: int,
        *,
        least: float = 1.0,
        height: int = 185,
    ) -> None:
        self._curves, self._origin, self._least = tuple(curves), origin_ns, least
        self._title = title
        self._chosen = [True] * len(self._curves)
        self._parts = min(_MOST_PARTS, 1 + max(len(curve.track.gaps()) for curve in self._curves))
        self._span = (0, 0)
        self._points: tuple[Array, list[Array]] = (np.zeros(0), [])
        self._plot = add_plot(page, title, self.panel, self._series(), height=height)

    def choose(self, wanted: Callable[[str], bool]) -> None:
        """Show those curves alone whose label `wanted` holds for; all, where it holds for none."""
        chosen = [wanted(curve.label) for curve in self._curves]
        self._chosen = chosen if any(chosen) else [True] * len(chosen)
        self._plot.series = self._series()

    def draw(self, begin_ns: int, end_ns: int, shown_ns: int) -> None:
        """Draw the span from `begin_ns` to `end_ns`, with the line at `shown_ns`."""
        if (begin_ns, end_ns) != self._span:
            self._span = (begin_ns, end_ns)
            self._points = self._envelopes(begin_ns, end_ns)
        time, values = self._points
        seen = [part[np.isfinite(part)] for part, chosen in zip(values, self._chosen, strict=True) if chosen]
        finite = np.concatenate(seen)
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
        short = max(0.0, self._least - (high - low)) / 2.0
        low, high = low - short, high + short
        shown = since(shown_ns, self._origin)
        place = int(np.searchsorted(time, shown))
        line, extent = np.full(len(time) + 2, np.nan), np.full(len(time) + 2, low)
        line[place : place + 2] = extent[:2] = low, high
        columns = []
        for curve in values:
            for part in parts_of(curve, self._parts):
                columns.append(np.insert(part, place, [np.interp(shown, time, part)] * 2))
        self._plot.data = (np.insert(time, place, [shown, shown]), extent, *columns, line)

    def panel(self) -> Panel:
        """Return what is to be seen as a plot for a file: the least and the largest values of each pixel's time."""
        time, values = self._points
        marks = [
            Curve(time, value, f"{curve.label}{' (second bag)' * curve.dashed}", curve.color, 1.0,
                  "dashed" if curve.dashed else "solid")
            for curve, value, chosen in zip(self._curves, values, self._chosen, strict=False)
            if chosen
        ]  # fmt: skip
        return Panel(marks, "", "time [s]", self._title)

    def _envelopes(self, begin_ns: int, end_ns: int) -> tuple[Array, list[Array]]:
        found = {}
        for curve in self._curves:
            key = (id(curve.track), curve.field)
            if key not in found:
                found[key] = curve.track.envelope(curve.field, begin_ns, end_ns, _BUCKETS)
        time_ns = found[id(self._curves[0].track), self._curves[0].field][0]
        columns = [curve.scale * found[id(curve.track), curve.field][1][:, curve.column] for curve in self._curves]
        return (time_ns - self._origin) / NANOSECONDS, columns

    def _series(self) -> tuple[uplot.Series, ...]:
        """Return how the columns are drawn: time, what the ordinate must show, the parts of each curve, and the line.

        uPlot draws a line across NaN, hence the parts.
        """
        lines = []
        for curve, chosen in zip(self._curves, self._chosen, strict=True):
            series = uplot.Series(
                label=curve.label, stroke=curve.color, width=1.5, show=chosen, auto=False, points={"show": False}
            )
            if curve.dashed:
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
        self._joints = recordings[0].arm.names
        whole = []
        if difference is not None:
            whole.append(("distance of the tips [mm]", _curves([difference.tip], "position", _MM)))
            whole.append(("difference of the joints [mrad]", _curves([difference.joints], "position", _MRAD)))
        if path_errors:
            whole.append(("path error at the tip [mm]", _curves(path_errors, "position", _MM)))
        whole.append(("joint angles [rad]", _curves([recording.arm for recording in recordings], "position")))
        legend = _legend(recordings)
        with page.plot_tab("Whole length"):
            page.gui.add_html(legend)
            self._whole = [CurvesPlot(page, title, curves, span_ns[0], least=_least(title)) for title, curves in whole]
            page.gui.add_markdown(_HINT)
        with page.plot_tab("Around the time"):
            page.gui.add_html(legend)
            joint = page.gui.add_dropdown("joint", (_ALL, *self._joints), initial_value=_ALL)
            self._width = page.gui.add_dropdown("width, s", _SPANS, initial_value="2")
            self._around = [
                CurvesPlot(page, title, curves, span_ns[0], least=_least(title))
                for title, curves in _states(recordings)
                if curves
            ]
        joint.on_update(lambda _: page.later(lambda: self._choose(joint.value)))
        self._width.on_update(lambda _: page.later(self.forget))
        self._drawn: int | None = None
        self._drawn_whole: int | None = None

    def forget(self) -> None:
        """Draw what was around the time at the next call, even if that is the same."""
        self._drawn = None

    def draw_whole(self, shown_ns: int) -> None:
        """Show a time in the plots of the whole length, if it is another one than before."""
        if shown_ns != self._drawn_whole:
            self._drawn_whole = shown_ns
            for plot in self._whole:
                plot.draw(*self._span, shown_ns)

    def draw_around(self, shown_ns: int) -> None:
        """Draw what was around a time, if it is another one than before."""
        if shown_ns != self._drawn:
            self._drawn = shown_ns
            half = round(float(self._width.value) * NANOSECONDS / 2)
            for plot in self._around:
                plot.draw(shown_ns - half, shown_ns + half, shown_ns)

    def _choose(self, joint: str) -> None:
        for plot in self._around:
            plot.choose(lambda name: joint in (_ALL, name))
        self.forget()


def _least(title: str) -> float:
    """Return the least length of a plot's ordinate, in its unit, by the title."""
    return next(length for unit, length in _LEAST.items() if title.endswith(unit))


def _legend(recordings: Sequence[Recording]) -> str:
    """Return the colours of joints and friction elements, as HTML."""
    first = recordings[0]
    names = first.arm.names if first.friction is None else first.friction.names
    parts = [
        f'<span style="color:{COLOURS[number % len(COLOURS)]}">&#9632;</span>&nbsp;{escape(name)}'
        for number, name in enumerate(names)
    ]
    text = " ".join([*parts, *[f"({_SECOND})"] * (len(recordings) - 1)])
    return f'<div style="padding:0.4em 0.8em 0;font-size:0.8em">{text}</div>'


def _states(recordings: Sequence[Recording]) -> list[tuple[str, list[RecordedCurve]]]:
    arms = [recording.arm for recording in recordings]
    frictions = [recording.friction for recording in recordings if recording.friction is not None]
    units = sorted({unit for arm in arms if (unit := arm.units.get("effort", "Nm")) != "Nm"})
    return [
        (f"effort [{' and '.join(units)}]" if units else "drive torque [Nm]", _curves(arms, "effort")),
        ("friction torque [Nm]", _curves(frictions, "effort")),
        ("velocity [rad/s]", _curves(arms, "velocity")),
        ("position [rad]", _curves(arms, "position")),
    ]


def _curves(tracks: Sequence[Track], field: str, scale: float = 1.0) -> list[RecordedCurve]:
    """Return the columns of tracks; those of the second are dashed."""
    return [
        RecordedCurve(name, track, field, column, scale, _color(track, column), dashed=number > 0)
        for number, track in enumerate(tracks)
        if field in track.values
        for column, name in enumerate(track.names)
    ]


def _color(track: Track, column: int) -> str:
    return COLOURS[column % len(COLOURS)] if len(track.names) > 1 else _OF_THE_TIP
