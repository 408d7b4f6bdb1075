"""Recordings on the page: one arm or two, the way of the tip, controls, plots and what the bags hold."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from time import monotonic

import numpy as np
import viser

from rx90_common.bags.recorded import time_shift
from rx90_common.base.arrays import Array
from rx90_common.base.quoting import one_line, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.report.plot import COLOURS, GREY, Curve, Panel
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.view.page import Page, from_user, on_change, put
from rx90_emulator.view.plots import NO_POINTS, Graph, add_plot_export, curves_of
from rx90_emulator.view.recording import (
    Difference,
    PathErrors,
    Recording,
    Track,
    difference,
    open_recording,
    path_errors,
    seconds,
    since,
    tip_path,
)
from rx90_emulator.view.scene import ArmScene, legend_html, line_colors

_POSE_PERIOD = 1.0 / 30.0  # s
_WINDOW_PERIOD = 0.15
_WHOLE_PERIOD = 0.4
_GHOST_COLOR = (0, 114, 178)
_PATH_SEGMENTS = 3000  # of the tip's way
_SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")
_STEP, _DIGITS = 1e-3, 3  # s, of the slider
_SLIDER_GRACE = 0.4  # s after the slider was moved by hand, in which it is not moved by the page
_MOST_MARKS = 12
_MOST_CHANGES = 30
_MOST_GAPS = 5
_ALL = "all joints"
_WINDOW_WIDTHS = ("0.02", "0.1", "0.5", "2", "10", "60")
_HINT = "Each point of a plot is the least or largest value in its share of the width: no peak is left out."


def _recording_text(recording: Recording, robot: str, origin_ns: int) -> str:
    """Return what a bag holds: robot, times, topics with their rates, gaps, changes of parameters, what it lacks."""
    arm, changes = recording.arm, recording.changes
    lasting = (arm.end_ns - arm.begin_ns) / NANOSECONDS
    gaps = [f"{seconds(a - origin_ns)} to {seconds(b - origin_ns)} s" for a, b in arm.gaps()]
    lines = [
        f"**{_escaped(recording.path.name)}** ({recording.kind}), robot {_escaped(robot)}, "
        f"{lasting:.3f} s from stamp {seconds(arm.begin_ns)} s"
    ]
    lines += [f"- Not in it: {', '.join(recording.lacking)}"] if recording.lacking else []
    lines += [f"- {_escaped(note)}" for note in recording.notes]
    if gaps:
        more = f" and {len(gaps) - _MOST_GAPS:,} more" if len(gaps) > _MOST_GAPS else ""
        lines.append(f"- Gaps, in which no arm is drawn: {', '.join(gaps[:_MOST_GAPS])}{more}")
    lines.append("")
    steps = len(arm.stamp_ns) - 1
    for topic in recording.topics:
        rate = f", {topic.count * steps / ((steps + 1) * lasting):.4g} Hz" if topic.is_joint_state else ""
        lines.append(f"- {_escaped(topic.name)}: {topic.count:,}{rate}")
    if changes:
        lines += ["", "| at s | parameter changed | to |", "|---:|---|---|"]
        for change in changes[:_MOST_CHANGES]:
            name = _escaped(f"{change.node} {change.name}")
            lines.append(f"| {seconds(change.stamp_ns - origin_ns)} | {name} | {_escaped(change.value)} |")
    if len(changes) > _MOST_CHANGES:
        lines.append(f"| | and {len(changes) - _MOST_CHANGES:,} more: rx90_bag info | |")
    return "\n".join(lines)


def _difference_text(found: Difference, names: Sequence[str], origin_ns: int, shift_ns: int) -> tuple[str, str]:
    """Return how far two recordings differ and how they were compared, and a table of the largest of each joint."""
    first, second = map(_escaped, names)
    ((apart, at_ns),) = found.tip.worst()
    lines = [
        f"**{second}** (ghost) less **{first}**: tips at most {1e3 * apart:.4g} mm apart, at "
        f"{seconds(at_ns - origin_ns)} s"
    ]
    if found.exact < 1.0:
        lines += ["", f"- {1.0 - found.exact:.1%} of the stamps of {first} fall between two of {second}: interpolated"]
    if shift_ns:
        lines += ["", f"- Stamps of {second} were moved by {shift_ns / NANOSECONDS:+.9f} s"]
    rows = ["| joint | largest, mrad | at s |", "|---|---:|---:|"]
    for name, (value, worst_ns) in zip(found.joints.names, found.joints.worst(), strict=True):
        rows.append(f"| {_escaped(name)} | {1e3 * value:.4g} | {seconds(worst_ns - origin_ns)} |")
    return "\n".join(lines), "\n".join(rows)


def _escaped(text: str) -> str:
    """Return text from outside that Markdown takes as it is."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-!|" else c for c in plain(text))


_MIN_RANGE = {"[mm]": 0.01, "[mrad]": 0.01, "[rad]": 0.01, "[rad/s]": 0.02, "[Nm]": 1.0}  # range of an ordinate
_BUCKETS = 300  # about one for each pixel of a plot
_MAX_PARTS = 8  # of a curve with gaps
_TIP_COLOR = "#111111"
_TIME_LINE = Curve(NO_POINTS, NO_POINTS, "shown", GREY)  # the vertical line


class TrackPlot(Graph):
    """A field of one track or of several, the second one's dashed, with a vertical line at the time that is shown.

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
        self._tracks, self._field, self._origin, self._scale = tracks, field, origin_ns, scale
        self._narrowest = next((width for unit, width in _MIN_RANGE.items() if title.endswith(unit)), 1.0)
        curves = [
            replace(curve, colour=curve.colour if len(track.names) > 1 else _TIP_COLOR,
                    dash="dashed" if number else "solid")
            for number, track in enumerate(tracks)
            for curve in curves_of(track.names)
        ]  # fmt: skip
        parts = min(_MAX_PARTS, 1 + max(len(track.gaps()) for track in tracks))
        super().__init__(page, title, [*curves, _TIME_LINE], parts=parts, height=185)
        self._drawn: tuple[int, int, int | None] = 0, 0, None  # beginning, end, and time that is shown, ns
        self._points: tuple[Array, list[Array]] = NO_POINTS, [NO_POINTS] * len(curves)

    def choose(self, labels: Collection[str]) -> None:
        """Show only the curves with these labels; all, where there are none of them."""
        every = {curve.label for curve in self._curves}
        super().choose((every & set(labels) or every) | {_TIME_LINE.label})
        self._drawn = (*self._drawn[:2], None)

    def draw(self, begin_ns: int, end_ns: int, shown_ns: int) -> None:
        """Draw the span from `begin_ns` to `end_ns`, with the line at `shown_ns`, unless that is what was drawn.

        Each interval of a plot has the least and the largest of its samples.
        """
        if (begin_ns, end_ns, shown_ns) == self._drawn:
            return
        if (begin_ns, end_ns) != self._drawn[:2]:
            found = [track.envelope(self._field, begin_ns, end_ns, _BUCKETS) for track in self._tracks]
            columns = [self._scale * column for _, values in found for column in values.T]
            self._points = (found[0][0] - self._origin) / NANOSECONDS, columns
        self._drawn = begin_ns, end_ns, shown_ns
        time, values = self._points
        seen = [curve.y for curve in self.panel().marks if isinstance(curve, Curve)]
        finite = np.concatenate([y[np.isfinite(y)] for y in seen])
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
        missing = max(0.0, self._narrowest - (high - low)) / 2.0
        shown = since(shown_ns, self._origin)
        place = int(np.searchsorted(time, shown))
        line = np.full(len(time) + 2, np.nan)
        line[place : place + 2] = low - missing, high + missing
        columns = [np.insert(y, place, [np.interp(shown, time, y)] * 2) for y in values]
        self.show(np.insert(time, place, [shown] * 2), [*columns, line])

    def panel(self) -> Panel:
        """Return what is to be seen, without the vertical line, as a plot for a file."""
        marks = [
            replace(one, x=self._points[0], y=y, label=one.label + " (second bag)" * (one.dash != "solid"))
            for one, y in zip(self._curves, self._points[1], strict=False)
            if one.label in self._chosen
        ]
        return Panel(marks, "", self._x, self._y)


class BagPlayer:
    """Plays a recording, or two on one time, the second as a ghost.

    Args:
        page: to draw in.
        robot: of the recordings.
        recordings: one or two.
        found: how two differ.
        shift_ns: what the second was moved by.

    Attributes:
        arms: that are drawn.
        time: that is shown, s; 0 is the beginning of the recordings.
        playing: whether time runs.
    """

    def __init__(
        self,
        page: Page,
        robot: RobotModel,
        recordings: Sequence[Recording],
        found: Difference | None = None,
        shift_ns: int = 0,
    ) -> None:
        self._page, self._recordings, self._difference = page, recordings, found
        begin = self._origin = min(recording.arm.begin_ns for recording in recordings)
        end = max(recording.arm.end_ns for recording in recordings)
        self._end, self.time, self.playing = since(end, begin), 0.0, False
        self._moved_at = self._set_to = 0.0  # when the slider was moved by hand; where the page has put it
        self._now = monotonic()
        self._shown: tuple[float, bool] | None = None
        self.arms = [ArmScene(page, "/arm", robot)]
        if len(recordings) > 1:
            self.arms.append(ArmScene(page, "/ghost", robot, ghost=_GHOST_COLOR))
        page.look_at_arm(robot)
        errors = [path_errors(recording.arm, recording.reference, robot) for recording in recordings]
        self._draw_path(robot, errors[0] and errors[0].distance)
        with page.tab("Bag"):
            self._add_controls()
            if errors[0] is not None:
                page.gui.add_html(legend_html())
            for recording, error in zip(recordings, errors, strict=True):
                if error is not None:
                    said = error.accuracy.words
                    if len(error.accuracy.times):
                        said += f"; furthest off at {seconds(error.distance.worst()[0][1] - begin)} s"
                    page.gui.add_markdown(f"{_escaped(recording.path.name)}: {said}")
            if found is not None:
                names = [recording.path.name for recording in recordings]
                text, joints = _difference_text(found, names, begin, shift_ns)
                page.gui.add_markdown(text)
                # Folded: on a telephone the plots stand below all this.
                with page.gui.add_folder("Largest differences by joint", expand_by_default=False):
                    page.gui.add_markdown(joints)
        with page.tab("About"):
            for recording in recordings:
                page.gui.add_markdown(_recording_text(recording, robot.model.name, begin))
        self._add_plots([error for error in errors if error is not None], end)
        with page.tab("Files"):
            add_plot_export(page)
        page.every(_POSE_PERIOD, self._update)

    def _add_controls(self) -> None:
        gui, page, found = self._page.gui, self._page, self._difference
        stamps = {change.stamp_ns for recording in self._recordings for change in recording.changes}
        marks = [mark for mark in (since(stamp, self._origin) for stamp in sorted(stamps)) if 0.0 <= mark <= self._end]
        self._slider = gui.add_slider(
            "time, s", 0.0, max(self._end, _STEP), _STEP, initial_value=0.0, marks=tuple(marks[:_MOST_MARKS]) or None
        )
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1", hint="recorded seconds in each second")
        self._loop = gui.add_checkbox("loop", initial_value=False, hint="begin again at the end")
        on_change(self._slider, self._scrub, page)
        self._play.on_click(from_user(self._toggle, page))
        self._ghost = None
        if found is not None:
            button = gui.add_button("Jump to the worst difference", icon=viser.Icon.TARGET_ARROW)
            button.on_click(from_user(partial(self.go_to, since(found.tip.worst()[0][1], self._origin)), page))
            self._ghost = gui.add_checkbox("ghost", initial_value=True, hint="draw the second bag's arm")
        self._status = gui.add_markdown("")

    def go_to(self, time: float) -> None:
        """Show a time, s, and stay there."""
        self.playing, self.time = False, min(max(time, 0.0), self._end)
        self._set_slider()

    def advance(self, now: float) -> None:
        """Let the steady clock come to `now`, s; at the end time stops, or begins again."""
        elapsed, self._now = now - self._now, now
        if self.playing:
            self.time += float(self._speed.value) * elapsed
            if self.time >= self._end and self._loop.value and self._end > 0.0:
                self.time %= self._end
            elif self.time >= self._end:
                self.time, self.playing = self._end, False
        # Another value than was set is one that a user has just chosen, and is taken first.
        if self._slider.value == self._set_to and now - self._moved_at > _SLIDER_GRACE:
            self._set_slider()
        label = "Pause" if self.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLAYER_PLAY

    def _set_slider(self) -> None:
        self._set_to = round(self.time, _DIGITS)
        put(self._slider, self._set_to)

    def _scrub(self) -> None:
        self._set_to, self._moved_at = self._slider.value, monotonic()
        self.time = min(max(self._set_to, 0.0), self._end)

    def _toggle(self) -> None:
        if not self.playing and self.time >= self._end:
            self.time = 0.0
        self.playing = not self.playing

    def _draw_path(self, robot: RobotModel, error: Track | None) -> None:
        """Draw where the first recording's tip has been."""
        points, error_of = tip_path(self._recordings[0].arm, error, robot.chain, _PATH_SEGMENTS)
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        colors = line_colors(error_of)
        there = np.isfinite(pieces).all(axis=(1, 2))
        if there.any():
            self._page.add_lines("/path", pieces[there], np.repeat(colors[there, None], 2, axis=1), thickness=4.0)

    def _add_plots(self, errors: Sequence[PathErrors], end: int) -> None:
        page, begin, found = self._page, self._origin, self._difference
        arms = [recording.arm for recording in self._recordings]
        frictions = [recording.friction for recording in self._recordings if recording.friction is not None]
        labels = " ".join(
            f'<span style="color:{COLOURS[number % len(COLOURS)]}">&#9632;</span>&nbsp;{escape(name)}'
            for number, name in enumerate((self._recordings[0].friction or arms[0]).names)
        )
        second = " (dashed: the second bag)" * (len(arms) - 1)
        legend = f'<div style="padding:0.4em 0.8em 0;font-size:0.8em">{labels}{second}</div>'

        def plots(*wanted: tuple[str, Sequence[Track], str, float]) -> list[TrackPlot]:
            held = ((title, [one for one in of if field in one.fields], field, k) for title, of, field, k in wanted)
            return [TrackPlot(page, title, of, field, begin, scale) for title, of, field, scale in held if of]

        with page.plot_tab("Whole length"):
            page.gui.add_html(legend)
            whole = plots(
                ("distance of the tips [mm]", [] if found is None else [found.tip], "position", 1e3),
                ("difference of the joints [mrad]", [] if found is None else [found.joints], "position", 1e3),
                ("path error at the tip [mm]", [one.distance for one in errors], "position", 1e3),
                ("tip ahead along the path [mm]", [one.along for one in errors], "position", 1e3),
                ("orientation error of the tool [mrad]", [one.orientation for one in errors], "position", 1e3),
                ("joint angles [rad]", arms, "position", 1.0),
            )
            page.gui.add_markdown(_HINT)
        units = sorted({unit for arm in arms if (unit := arm.units["effort"]) != "Nm"})
        with page.plot_tab("Around the time"):
            page.gui.add_html(legend)
            joint = page.gui.add_dropdown("joint", (_ALL, *arms[0].names), initial_value=_ALL)
            width = page.gui.add_dropdown("width, s", _WINDOW_WIDTHS, initial_value="2")
            around = plots(
                (f"effort [{' and '.join(units)}]" if units else "drive torque [Nm]", arms, "effort", 1.0),
                ("friction torque [Nm]", frictions, "effort", 1.0),
                ("velocity [rad/s]", arms, "velocity", 1.0),
                ("position [rad]", arms, "position", 1.0),
            )

        def choose() -> None:
            for plot in around:
                plot.choose({joint.value})

        def draw_around(_now: float) -> None:
            half, shown = round(float(width.value) * NANOSECONDS / 2), self.shown_ns
            for plot in around:
                plot.draw(shown - half, shown + half, shown)

        def draw_whole(_now: float) -> None:
            for plot in whole:
                plot.draw(begin, end, self.shown_ns)

        joint.on_update(from_user(choose, page))
        page.every(_WINDOW_PERIOD, draw_around)
        page.every(_WHOLE_PERIOD, draw_whole)

    @property
    def shown_ns(self) -> int:
        """Return the stamp that is shown."""
        return self._origin + round(self.time * NANOSECONDS)

    def _update(self, now: float) -> None:
        self.advance(now)
        with_ghost = self._ghost is None or self._ghost.value
        if (self.time, with_ghost) == self._shown:
            return
        self._shown = self.time, with_ghost
        stamp = np.array([self.shown_ns])
        lines = [f"Stamp {seconds(self.shown_ns)} s"]
        for arm, recording in zip(self.arms, self._recordings, strict=True):
            position = recording.arm.at("position", stamp)[0]
            known = bool(np.isfinite(position).all())
            arm.root.visible = known and (with_ghost or arm is self.arms[0])
            if known:
                arm.show(position)
            else:
                lines.append(f"no states of {plain(recording.path.name)} at this time")
        if self._difference is not None:
            apart = float(self._difference.tip.at("position", stamp)[0, 0])
            lines.append(f"tips {1e3 * apart:.4g} mm apart" if np.isfinite(apart) else "no difference at this time")
        self._status.content = "; ".join(lines)


def open_player(
    make_page: Callable[[], Page], paths: Sequence[Path], files: RobotFiles, layout: MeasuredLayout, align: int | str
) -> tuple[Page, BagPlayer]:
    """Read one bag or two, and only then make the page and show them.

    Args:
        make_page: called once the bags are read.
        paths: of the bags.
        files: of the robot that they are of.
        layout: what their messages hold where it is not as here.
        align: what the stamps of the second are moved by, as in `Scope`.

    Raises:
        Rx90Error: for bags that cannot be read or do not fit together, robot files and pages that cannot be.
    """
    robot = load_robot(files.urdf, files.tool)
    recordings = [open_recording(path, robot, files, layout) for path in paths]
    for path, recording in zip(paths, recordings, strict=True):
        for note in recording.notes:
            print(one_line(f"{path}: {note}"), file=sys.stderr)
    found, shift = None, 0
    if len(recordings) > 1:
        first, second = recordings
        shift = time_shift(align, first, second)
        recordings[1] = second = second.moved(shift)
        found = difference(first.arm, second.arm, robot.chain, (first.path, second.path))
    page = make_page()
    try:
        return page, BagPlayer(page, robot, recordings, found, shift)
    except BaseException:
        page.close()
        raise
