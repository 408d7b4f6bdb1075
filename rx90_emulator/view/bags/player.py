"""Recordings on the page: one arm or two, the way of the tip, controls, plots and what the bags hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.robot import RobotModel
from rx90_emulator.view.arm import ArmScene
from rx90_emulator.view.bags.bag_plots import BagPlots
from rx90_emulator.view.bags.controls import PlayControls
from rx90_emulator.view.bags.difference import Difference
from rx90_emulator.view.bags.facts import difference_text, joint_differences, path_error_text, recording_text
from rx90_emulator.view.bags.path import path_error_track, tip_path
from rx90_emulator.view.bags.playback import Playback
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.times import seconds, since
from rx90_emulator.view.bags.track import Track
from rx90_emulator.view.line import legend_html, line_colors
from rx90_emulator.view.page import Page
from rx90_emulator.view.plot_export import PlotExport

_POSE_PERIOD = 1.0 / 30.0  # s
_AROUND_PERIOD = 0.15
_WHOLE_PERIOD = 0.4
_GHOST = (0, 114, 178)
_PIECES = 3000  # of the tip's way


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
        self.playback = Playback((end - begin) / NANOSECONDS)
        self.arms = [ArmScene(page, "/arm", robot)]
        if len(recordings) > 1:
            self.arms.append(ArmScene(page, "/ghost", robot, ghost=_GHOST))
        page.look_at_arm(robot)
        errors = [path_error_track(recording, robot.chain) for recording in recordings]
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
            PlotExport(page)
        self._shown: float | None = None
        self._hidden = False  # the ghost
        self._before: float | None = None
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
        self._controls = PlayControls(page, self.playback, [mark for mark in marks if 0.0 <= mark <= self.playback.end])
        if self._difference is not None:
            worst = self._difference.worst_tip.time_ns
            button = gui.add_button("Jump to the worst difference", icon=viser.Icon.TARGET_ARROW)
            button.on_click(lambda _: page.later(lambda: self._controls.go_to(since(worst, self._origin))))
            ghost = gui.add_checkbox("ghost", initial_value=True, hint="draw the second bag's arm")
            ghost.on_update(lambda _: page.later(lambda: self._draw_ghost(ghost.value)))
        self._status = gui.add_markdown("")

    def _draw_ghost(self, wanted: bool) -> None:
        self._hidden, self._shown = not wanted, None

    def _draw_path(self, page: Page, robot: RobotModel, error: Track | None) -> None:
        """Draw where the first recording's tip has been."""
        path = tip_path(self._recordings[0].arm, error, robot.chain, _PIECES)
        pieces = np.stack([path.points[:-1], path.points[1:]], axis=1)
        colors = line_colors(path.error)
        there = np.isfinite(pieces).all(axis=(1, 2))
        if there.any():
            page.scene.add_line_segments(
                "/path", pieces[there].astype(np.float32), np.repeat(colors[there, None], 2, axis=1),
                thickness=4.0, thickness_units="screen",
            )  # fmt: skip

    def _update(self, now: float) -> None:
        if self._before is not None:
            self.playback.advance(now - self._before)
        self._before = now
        self._controls.follow(now)
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
