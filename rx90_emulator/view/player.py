"""Recordings on the page: one arm or two, the way of the tip, controls, plots and what the bags hold."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

import numpy as np
import viser

from rx90_common.bags.recorded import time_shift
from rx90_common.base.quoting import one_line, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.view.bag_plots import BagPlots
from rx90_emulator.view.page import Page, from_user, on_change, put
from rx90_emulator.view.plots import add_plot_export
from rx90_emulator.view.recording import Recording, open_recording
from rx90_emulator.view.scene import ArmScene, legend_html, line_colors
from rx90_emulator.view.track import Difference, Track, difference, path_error_track, seconds, since, tip_path

_POSE_PERIOD = 1.0 / 30.0  # s
_AROUND_PERIOD = 0.15
_WHOLE_PERIOD = 0.4
_GHOST = (0, 114, 178)
_PIECES = 3000  # of the tip's way
_SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")
_STEP, _DIGITS = 1e-3, 3  # s, of the slider
_HOLDS_STILL = 0.4  # s after the slider was moved by hand, in which it is not moved by the page
_MOST_MARKS = 12
_MOST_CHANGES = 30
_MOST_GAPS = 5


def recording_text(recording: Recording, robot: str, origin_ns: int) -> str:
    """Return what a bag holds: robot, times, topics with their rates, gaps, and what it lacks.

    Args:
        recording: of a bag.
        robot: its name.
        origin_ns: where the page's time is 0.
    """
    arm = recording.arm
    lasting = (arm.end_ns - arm.begin_ns) / NANOSECONDS
    gaps = arm.gaps()
    lines = [
        f"**{_escaped(recording.path.name)}** ({recording.kind}), robot {_escaped(robot)}, "
        f"{lasting:.3f} s from stamp {seconds(arm.begin_ns)} s"
    ]
    lines += [f"- Not in it: {', '.join(recording.lacking)}"] if recording.lacking else []
    lines += [f"- {_escaped(note)}" for note in recording.notes]
    if len(gaps):
        shown = ", ".join(f"{seconds(a - origin_ns)} to {seconds(b - origin_ns)} s" for a, b in gaps[:_MOST_GAPS])
        more = f" and {len(gaps) - _MOST_GAPS:,} more" if len(gaps) > _MOST_GAPS else ""
        lines.append(f"- Gaps, in which no arm is drawn: {shown}{more}")
    lines.append("")
    steps = len(arm.time_ns) - 1
    for topic in recording.topics:
        rate = f", {topic.count * steps / ((steps + 1) * lasting):.4g} Hz" if topic.is_joint_state else ""
        lines.append(f"- {_escaped(topic.name)}: {topic.count:,}{rate}")
    return "\n".join(lines + _changes(recording, origin_ns))


def _changes(recording: Recording, origin_ns: int) -> list[str]:
    if not recording.changes:
        return []
    lines = ["", "| at s | parameter changed | to |", "|---:|---|---|"]
    for change in recording.changes[:_MOST_CHANGES]:
        name = _escaped(f"{change.node} {change.name}")
        lines.append(f"| {seconds(change.stamp_ns - origin_ns)} | {name} | {_escaped(change.value)} |")
    left = len(recording.changes) - _MOST_CHANGES
    return lines + ([f"| | and {left:,} more: rx90_bag info | |"] if left > 0 else [])


def path_error_text(name: str, error: Track, origin_ns: int) -> str:
    """Return the largest path error of a recording and when it was, on the time of the page."""
    values = error.values["position"][:, 0]
    if not np.isfinite(values).any():
        return f"{_escaped(name)}: its set-points never move"
    row = int(np.nanargmax(values))
    at = seconds(int(error.time_ns[row]) - origin_ns)
    return f"{_escaped(name)}: largest path error {1e3 * values[row]:.3f} mm, at {at} s"


def difference_text(found: Difference, names: Sequence[str], origin_ns: int, shift_ns: int) -> str:
    """Return how far two recordings differ, and how they were compared.

    Args:
        found: of the recordings.
        names: of both bags.
        origin_ns: where the page's time is 0.
        shift_ns: what the stamps of the second were moved by.
    """
    first, second = map(_escaped, names)
    tip = found.worst_tip
    lines = [
        f"**{second}** (ghost) less **{first}**: tips at most {1e3 * tip.value:.4g} mm apart, at "
        f"{seconds(tip.time_ns - origin_ns)} s"
    ]
    if found.exact < 1.0:
        lines += ["", f"- {1.0 - found.exact:.1%} of the stamps of {first} fall between two of {second}: interpolated"]
    if shift_ns:
        lines += ["", f"- Stamps of {second} were moved by {shift_ns / NANOSECONDS:+.9f} s"]
    return "\n".join(lines)


def joint_differences(found: Difference, origin_ns: int) -> str:
    """Return the largest difference of each joint as a table; `origin_ns` is where the page's time is 0."""
    lines = ["| joint | largest, mrad | at s |", "|---|---:|---:|"]
    for name, worst in zip(found.joints.names, found.worst_joints, strict=True):
        lines.append(f"| {_escaped(name)} | {1e3 * worst.value:.4g} | {seconds(worst.time_ns - origin_ns)} |")
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Return text from outside that Markdown takes as it is."""
    return "".join(f"\\{c}" if c in r"\`*_{}[]<>()#+-!|" else c for c in plain(text))


class Playback:
    """A time between the beginning and the end of what is played, with slider, buttons and choices.

    Args:
        page: to draw in, within a `tab`.
        end: s; the beginning is 0.
        marks: times, s, that stand below the slider.

    Attributes:
        time: that is shown, s.
        playing: whether time runs.
    """

    def __init__(self, page: Page, end: float, marks: Sequence[float]) -> None:
        gui = page.gui
        self._end, self.time, self.playing = end, 0.0, False
        self._moved_at = self._set_to = 0.0
        self._now = monotonic()
        self._slider = gui.add_slider(
            "time, s", 0.0, max(end, _STEP), _STEP, initial_value=0.0, marks=tuple(marks[:_MOST_MARKS]) or None
        )
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1", hint="recorded seconds in each second")
        self._loop = gui.add_checkbox("loop", initial_value=False, hint="begin again at the end")
        on_change(self._slider, self._scrubbed, page)
        self._play.on_click(from_user(self._toggle, page))

    def go_to(self, time: float) -> None:
        """Show a time, s, and stay there."""
        self.playing, self.time = False, min(max(time, 0.0), self._end)
        self._set(self.time)

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
        if self._slider.value == self._set_to and now - self._moved_at > _HOLDS_STILL:
            self._set(self.time)
        label = "Pause" if self.playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLAYER_PLAY

    def _set(self, time: float) -> None:
        self._set_to = round(time, _DIGITS)
        put(self._slider, self._set_to)

    def _scrubbed(self) -> None:
        self._set_to, self._moved_at = self._slider.value, monotonic()
        self.time = min(max(self._set_to, 0.0), self._end)

    def _toggle(self) -> None:
        if not self.playing and self.time >= self._end:
            self.time = 0.0
        self.playing = not self.playing


class BagPlayer:
    """Plays a recording, or two on one time, the second as a ghost.

    Args:
        page: to show them on.
        robot: the arm of both.
        recordings: one or two; the second is already moved to the first one's time.
        difference: of two.
        shift_ns: what the second was moved by.
    """

    def __init__(
        self,
        page: Page,
        robot: RobotModel,
        recordings: Sequence[Recording],
        difference: Difference | None = None,
        shift_ns: int = 0,
    ) -> None:
        self._recordings = tuple(recordings)
        begin = min(recording.arm.begin_ns for recording in recordings)
        end = max(recording.arm.end_ns for recording in recordings)
        self._origin = begin
        self._difference = difference
        self._lasting = (end - begin) / NANOSECONDS
        self.arms = [ArmScene(page, "/arm", robot)]
        if len(recordings) > 1:
            self.arms.append(ArmScene(page, "/ghost", robot, ghost=_GHOST))
        page.look_at_arm(robot)
        errors = [path_error_track(recording.arm, recording.reference, robot.chain) for recording in recordings]
        self._draw_path(page, robot, errors[0])
        with page.tab("Bag"):
            self._add_controls(page)
            if errors[0] is not None:
                page.gui.add_html(legend_html())
            for recording, error in zip(recordings, errors, strict=True):
                if error is not None:
                    page.gui.add_markdown(path_error_text(recording.path.name, error, begin))
            if difference is not None:
                names = [recording.path.name for recording in recordings]
                page.gui.add_markdown(difference_text(difference, names, begin, shift_ns))
                # Folded: on a telephone the plots stand below all this.
                with page.gui.add_folder("Largest differences by joint", expand_by_default=False):
                    page.gui.add_markdown(joint_differences(difference, begin))
        with page.tab("About"):
            for recording in recordings:
                page.gui.add_markdown(recording_text(recording, robot.model.name, begin))
        known = [error for error in errors if error is not None]
        self._plots = BagPlots(page, recordings, difference, known, (begin, end))
        with page.tab("Files"):
            add_plot_export(page)
        self._shown: float | None = None
        self._hidden = False  # the ghost
        page.every(_POSE_PERIOD, self._update)
        page.every(_AROUND_PERIOD, lambda _: self._plots.draw_around(self.shown_ns))
        page.every(_WHOLE_PERIOD, lambda _: self._plots.draw_whole(self.shown_ns))

    @property
    def shown_ns(self) -> int:
        """Return the stamp that is shown."""
        return self._origin + round(self.playback.time * NANOSECONDS)

    def _add_controls(self, page: Page) -> None:
        gui = page.gui
        changes = sorted({change.stamp_ns for recording in self._recordings for change in recording.changes})
        marks = [since(stamp, self._origin) for stamp in changes]
        self.playback = Playback(page, self._lasting, [mark for mark in marks if 0.0 <= mark <= self._lasting])
        if self._difference is not None:
            worst = self._difference.worst_tip.time_ns
            button = gui.add_button("Jump to the worst difference", icon=viser.Icon.TARGET_ARROW)
            button.on_click(lambda _: page.later(lambda: self.playback.go_to(since(worst, self._origin))))
            ghost = gui.add_checkbox("ghost", initial_value=True, hint="draw the second bag's arm")
            ghost.on_update(lambda _: page.later(lambda: self._draw_ghost(ghost.value)))
        self._status = gui.add_markdown("")

    def _draw_ghost(self, wanted: bool) -> None:
        self._hidden, self._shown = not wanted, None

    def _draw_path(self, page: Page, robot: RobotModel, error: Track | None) -> None:
        """Draw where the first recording's tip has been."""
        points, error_of = tip_path(self._recordings[0].arm, error, robot.chain, _PIECES)
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        colors = line_colors(error_of)
        there = np.isfinite(pieces).all(axis=(1, 2))
        if there.any():
            page.add_lines("/path", pieces[there], np.repeat(colors[there, None], 2, axis=1), 4.0)

    def _update(self, now: float) -> None:
        self.playback.advance(now)
        if self.playback.time != self._shown:
            self._shown = self.playback.time
            self._show()

    def _show(self) -> None:
        stamp = np.array([self.shown_ns])
        lines = [f"Stamp {seconds(self.shown_ns)} s"]
        for arm, recording in zip(self.arms, self._recordings, strict=True):
            position = recording.arm.at("position", stamp)[0]
            known = bool(np.isfinite(position).all())
            arm.visible = known and not (self._hidden and arm is self.arms[-1])
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
        shift = time_shift(align, *recordings)
        recordings[1] = recordings[1].moved(shift)
        first, second = recordings
        found = difference(first.arm, second.arm, robot.chain, (first.path, second.path))
    page = make_page()
    try:
        return page, BagPlayer(page, robot, recordings, found, shift)
    except BaseException:
        page.close()
        raise
