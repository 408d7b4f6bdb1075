"""What `rx90 view --demo` shows: nodes of its own, whose arm goes along the line again and again."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import replace

from rx90_common.base.errors import ExchangeError, Rx90Error
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.lines.plan import LinePlan
from rx90_controller.node.trajectory_client import deliver
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.live import LiveView
from rx90_emulator.view.page import Page

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
        limits = setup.controller.limits(setup.robot)
        period = setup.rates.position_period
        self._line = plan, controller, limits, period, True
        self._group = ProcessGroup()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the nodes; the arm stands straight up."""
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        print(
            f"starting simulation and controller; in another terminal: export ROS_DOMAIN_ID={domain}",
            flush=True,
        )
        self._cell = self._group.start("nodes", self._command)

    def follow(self, page: Page, view: LiveView, started: Callable[[], None]) -> None:
        """Move the arm from now on, call `started` when it is seen; the page ends with an error when the nodes do."""

        def check(_now: float) -> None:
            if self._cell.returncode is not None:
                self._cell.wait_for("$^")  # says that it has ended, and its last line
            if view.state is not None:
                started()

        page.every(_TOUR_PERIOD, check)
        self._thread = threading.Thread(
            target=self._send_again_and_again, args=[view], name="tour", daemon=True
        )
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
            except (
                Rx90Error
            ) as error:  # torque off, somebody else's motion: the next time it may go
                if str(error) != said and not self._ending.is_set():
                    said = str(error)
                    print(f"rx90 view: the line was not sent: {said}", flush=True)
            self._ending.wait(_REST)
            while not self._ending.wait(_TOUR_PERIOD) and not view.rests(_REST):
                pass  # until the trajectory that was accepted last is over
