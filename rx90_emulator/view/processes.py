"""Processes that the page starts: a recorder of the running nodes, and the nodes of a demonstration."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from rx90_common.base.errors import ExchangeError, Rx90Error
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_controller.lines.plan import Approach, LinePlan
from rx90_controller.node.trajectory_client import deliver
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.live import LiveView
from rx90_emulator.view.page import Page, from_user, output_path, sentence

_RECORDER_PERIOD = 0.25  # s
_GRACE = 10.0  # s for a recorder to finish its bag when the page ends
_LAST = 6  # lines of the recorder that are shown
_START_LABEL, _END_LABEL = "Record", "End the recording"


class RecordButton:
    """A bag's name, a button, and what the recorder says.

    Args:
        page: to build in, within a tab; the bag goes beneath its folder.
        namespace: of the nodes, as "/cell_1"; empty for none.
        ros_args: of the recorder's node.
    """

    def __init__(self, page: Page, namespace: str, ros_args: Sequence[str]) -> None:
        self._output = page.output
        self._ros_args = ["--ros-args", *ros_args, *(["-r", f"__ns:={namespace}"] if namespace else [])]
        self._group = ProcessGroup(grace=_GRACE)
        self.close = self._group.end  # in order, and waits for that
        self._recorder: ChildProcess | None = None
        self._ready: float | None = None
        self._name = page.gui.add_text("bag", "bag")
        self._button = page.gui.add_button(_START_LABEL)
        self._said = page.gui.add_html(sentence(f"A new folder beneath {page.output}."))
        self._button.on_click(from_user(self._press, page))
        page.every(_RECORDER_PERIOD, self._follow)

    def _press(self) -> None:
        if self._recorder is not None:
            self._button.disabled = True
            self._recorder.signal(signal.SIGINT)
            return
        try:
            path = output_path(self._output, self._name.value)
        except Rx90Error as error:
            self._said.content = sentence(str(error), wrong=True)
            return
        command = executable("rx90_bag", "record", "--output", path, *self._ros_args)
        self._recorder, self._ready = self._group.start("recorder", command), None
        self._button.label, self._name.disabled = _END_LABEL, True
        self._said.content = sentence("the recorder starts ...")

    def _follow(self, now: float) -> None:
        if self._recorder is None:
            return
        code = self._recorder.returncode
        if code is not None:
            self._recorder.wait()  # for its last lines
            self._said.content = "".join(sentence(line, wrong=code != 0) for line in self._recorder.lines[-_LAST:])
            self._recorder, self._button.label = None, _START_LABEL
            self._button.disabled = self._name.disabled = False
        elif lines := self._recorder.lines:
            if self._ready is None and any(line.startswith("ready: ") for line in lines):
                self._ready = now
            words = lines[-1]
            if self._ready is not None:
                words = f"recording to {self._name.value}: {now - self._ready:.0f} s"
            self._said.content = sentence(words)


_REST = 1.0  # s between two lines
_TIMEOUT = 60.0  # s, for nodes that come up on a busy machine
_TOUR_PERIOD = 0.2  # s


class Tour:
    """Simulation and controller in a process, and a thread that sends the line when the arm has come to rest.

    Args:
        robot: its name or folder, for the nodes.
        setup: of the robot.
        plan: of its reference line or path.
        controller: name of the controller node.
    """

    def __init__(self, robot: str, setup: Setup, plan: LinePlan, controller: str) -> None:
        self._command = executable("rx90_cell", "--ros-args", "-p", f"robot:={robot}")
        limits, period = setup.controller.limits(setup.robot), setup.rates.position_period
        self._line = plan, controller, limits, period, Approach()
        self._group = ProcessGroup()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the nodes; the arm stands straight up."""
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        print(f"starting simulation and controller; in another terminal: export ROS_DOMAIN_ID={domain}", flush=True)
        self._cell = self._group.start("nodes", self._command)

    def follow(self, page: Page, view: LiveView, started: Callable[[], None]) -> None:
        """Move the arm from now on, call `started` when it is seen; the page ends with an error when the nodes do."""

        def check(_now: float) -> None:
            if self._cell.returncode is not None:
                self._cell.wait_for("$^")  # says that it has ended, and its last line
            if view.state is not None:
                started()

        page.every(_TOUR_PERIOD, check)
        self._thread = threading.Thread(target=self._send_again_and_again, args=[view], name="tour", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End thread and nodes."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(_TIMEOUT)
        self._group.__exit__()

    def _send_again_and_again(self, view: LiveView) -> None:
        def leave_at_the_end() -> None:
            if self._ending.is_set():
                raise ExchangeError("the page has ended")

        said = ""
        while not self._ending.is_set():
            try:
                with client_node("rx90_view_line", _TIMEOUT, lambda _: None) as client:
                    deliver(replace(client, check_interrupt=leave_at_the_end), *self._line)
            except Rx90Error as error:  # torque off, somebody else's motion: the next time it may go
                if str(error) != said and not self._ending.is_set():
                    said = str(error)
                    print(f"rx90_view: the line was not sent: {said}", flush=True)
            self._ending.wait(_REST)
            while not self._ending.wait(_TOUR_PERIOD) and not view.rests(_REST):
                pass  # until the trajectory that was accepted last is over
