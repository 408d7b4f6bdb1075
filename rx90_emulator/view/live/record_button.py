"""A button that records the running nodes to a bag, with the recorder of `rx90_bag record`."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Sequence

from rx90_common.base.errors import Rx90Error
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_emulator.view.changes import from_user
from rx90_emulator.view.page import Page
from rx90_emulator.view.widgets import sentence

_LOOKS = 0.25  # s
_GRACE = 10.0  # s for a recorder to finish its bag when the page ends
_SAID = 6  # lines
_START, _END = "Record", "End the recording"


class RecordButton:
    """A bag's name, a button, and what the recorder says.

    Args:
        page: to build in, within a tab; the bag goes beneath its folder.
        namespace: of the nodes, as "/cell_1"; empty for none.
        ros_args: of the recorder's node.
    """

    def __init__(self, page: Page, namespace: str, ros_args: Sequence[str]) -> None:
        self._page = page
        self._ros_args = ["--ros-args", *ros_args, *(["-r", f"__ns:={namespace}"] if namespace else [])]
        self._group = ProcessGroup(grace=_GRACE)
        self._recorder: ChildProcess | None = None
        self._ready: float | None = None
        self._name = page.gui.add_text("bag", "bag")
        self._button = page.gui.add_button(_START)
        self._said = page.gui.add_html(sentence(f"A new folder beneath {page.output.folder}."))
        self._button.on_click(from_user(self._press, page))
        page.every(_LOOKS, self._follow)

    def close(self) -> None:
        """End a recording in order, and wait for that."""
        self._group.end()

    def _press(self) -> None:
        if self._recorder is not None:
            self._button.disabled = True
            self._recorder.signal(signal.SIGINT)
            return
        try:
            path = self._page.output.path_for(self._name.value)
        except Rx90Error as error:
            self._said.content = sentence(str(error), wrong=True)
            return
        command = executable("rx90_bag", "record", "--output", path, *self._ros_args)
        self._recorder, self._ready = self._group.start("recorder", command), None
        self._button.label, self._name.disabled = _END, True
        self._said.content = sentence("the recorder starts ...")

    def _follow(self, now: float) -> None:
        recorder = self._recorder
        if recorder is None:
            return
        code = recorder.returncode
        if code is None:
            lines = recorder.lines
            if self._ready is None and any(re.match("ready: ", line) for line in lines):
                self._ready = time.monotonic()
            if self._ready is not None:
                self._said.content = sentence(f"recording to {self._name.value}: {now - self._ready:.0f} s")
            elif lines:
                self._said.content = sentence(lines[-1])
            return
        recorder.wait()  # for its last lines
        self._said.content = "".join(sentence(line, wrong=code != 0) for line in recorder.lines[-_SAID:])
        self._recorder, self._button.label = None, _START
        self._button.disabled = self._name.disabled = False
