"""The form for a straight line: checked while it is typed, drawn in the scene, sent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_controller.lines.task import LineTask
from rx90_emulator.view.changes import from_user, on_change
from rx90_emulator.view.line import PLANNED
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.newest import NewestOnly
from rx90_emulator.view.panel.typed_line import LineChecker, LinePreview, TypedLine
from rx90_emulator.view.widgets import sentence

_INTERVAL = 0.1  # s from one check to the next while somebody types
_STANDS, _ELSEWHERE = 1e-4, 1e-2  # rad, from one look to the next; from where it was checked


class LineForm:
    """Fields for start, end, speed, acceleration and tool; a line that says what comes of them; a button to send it.

    Args:
        page: to build in, within a tab.
        checker: checks.
        task: what stands in the fields at first.
        send: takes a line that was checked, when the button is pressed.
    """

    def __init__(self, page: Page, checker: LineChecker, task: LineTask, send: Callable[[LinePreview], None]) -> None:
        self._page, self._checker, self._send = page, checker, send
        self._here: Array | None = None
        self._checked_from: Array | None = None
        self._missing = ""
        self._number = 0  # of the newest check
        self._wanted = False
        self.preview: LinePreview | None = None
        first = TypedLine.of(task)
        self._fields = [
            page.gui.add_text(label, text)
            for label, text in (
                ("start, m", first.start),
                ("end, m", first.end),
                ("speed, m/s", first.speed),
                ("acceleration, m/s²", first.acceleration),
                ("tool rpy, deg", first.tool_rpy),
            )
        ]
        self._verdict = page.gui.add_html("")
        self._button = page.gui.add_button("Send the line", disabled=True)
        self._reason = page.gui.add_html("")
        self._drawn = [
            page.scene.add_line_segments(
                f"/panel/{name}",
                np.zeros((1, 2, 3), dtype=np.float32),
                PLANNED,
                thickness=thickness,
                thickness_units="screen",
                visible=False,
            )
            for name, thickness in (("line", 3.0), ("approach", 1.5))
        ]
        self._checking: NewestOnly[tuple[int, TypedLine, Array | None]] = NewestOnly(self._check, _INTERVAL)
        for field in self._fields:
            on_change(field, self._typed, page)
        self._button.on_click(from_user(self._pressed, page))
        self._typed()

    def close(self) -> None:
        """End the thread that checks."""
        self._checking.close()

    def follow(self, here: Array | None, missing: str) -> None:
        """Take where the arm is, rad, shape (6,), None for unknown, and what is missing to send a line, if anything.

        Where the arm has come to rest elsewhere, the approach is another one.
        """
        stands = here is not None and self._here is not None and np.abs(here - self._here).max() < _STANDS
        self._here, self._missing = here, missing
        before = self._checked_from
        if stands and here is not None and (before is None or np.abs(here - before).max() > _ELSEWHERE):
            self._give()
        self._enable()

    def _typed(self) -> None:
        self._wanted = False
        self._give()

    def _pressed(self) -> None:
        # The arm may have moved since the line was checked.
        self._wanted = True
        self._give()

    def _give(self) -> None:
        self.preview = None
        self._verdict.content = sentence("checking ...")
        self._enable()
        self._checked_from = self._here
        self._number += 1
        self._checking.give((self._number, TypedLine(*(field.value for field in self._fields)), self._here))

    def _check(self, item: tuple[int, TypedLine, Array | None]) -> None:
        """Check on a thread of its own."""
        number, typed, here = item
        try:
            found: LinePreview | LineError = self._checker.preview(typed, here)
        except LineError as error:
            found = error
        self._page.later(lambda: self._found(number, found))

    def _found(self, number: int, found: LinePreview | LineError) -> None:
        if number != self._number:
            return  # of other values than those in the fields, or of an arm that has moved
        wanted, self._wanted = self._wanted, False
        line, approach = self._drawn
        if isinstance(found, LineError):
            self._verdict.content = sentence(str(found), wrong=True)
            line.visible = approach.visible = False
            return
        self.preview = found
        self._verdict.content = sentence(found.text())
        task = found.plan.task
        line.points = np.array([[task.start, task.end]], dtype=np.float32)
        line.visible, approach.visible = True, len(found.approach) > 0
        if len(found.approach):
            way = found.approach.astype(np.float32)
            approach.points = np.stack([way[:-1], way[1:]], axis=1)
        if wanted and not self._missing:
            self._send(found)
        self._enable()

    def _enable(self) -> None:
        disabled = self.preview is None or bool(self._missing)
        if self._button.disabled != disabled:
            self._button.disabled = disabled
        reason = sentence(f"cannot be sent: {self._missing}") if self._missing else ""
        if self._reason.content != reason:
            self._reason.content = reason
