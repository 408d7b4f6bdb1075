"""The plots of recordings: the whole length, and what was around the time that is shown."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.plot import COLOURS
from rx90_emulator.view.bags.curves import CurvesPlot, RecordedCurve
from rx90_emulator.view.bags.difference import Difference
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.track import Track
from rx90_emulator.view.page import Page

_ALL = "all joints"
_SPANS = ("0.02", "0.1", "0.5", "2", "10", "60")
_MM, _MRAD = 1e3, 1e3
_LEAST = {"[mm]": 0.01, "[mrad]": 0.01, "[rad]": 0.01, "[rad/s]": 0.02, "[Nm]": 1.0}
_HINT = "Each point of a plot is the least or largest value in its share of the width: no peak is left out."
_OF_THE_TIP = "#111111"
_SECOND = "dashed: the second bag"


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
