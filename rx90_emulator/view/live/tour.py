"""Nodes of one's own, whose arm moves along the reference line again and again."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import replace

from rx90_common.base.errors import ExchangeError, Rx90Error
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ChildProcess, ProcessGroup, executable
from rx90_controller.law.parameters import load_controller
from rx90_controller.lines.plan import Approach, plan_line
from rx90_controller.lines.task import load_task
from rx90_controller.node.trajectory_client import Delivery, deliver
from rx90_emulator.view.live.live_view import LiveView
from rx90_emulator.view.page import Page

_SET_POINT_PERIOD = 1e-3  # s
_APPROACH = Approach()
_REST = 1.0  # s between two lines
_TIMEOUT = 60.0  # s, for nodes that come up on a busy machine
_LOOK = 0.2  # s


class Tour:
    """Simulation and controller in a process, and a thread that sends the line when the arm has come to rest.

    Args:
        robot: its name or folder, for the nodes.
        files: its files, with a task.
        controller: name of the controller node.

    Raises:
        Rx90Error: if the robot has no reference line or cannot travel it.
    """

    def __init__(self, robot: str, files: RobotFiles, controller: str) -> None:
        model = load_robot(files.urdf, files.tool)
        self._robot = robot
        self._plan = plan_line(model, load_task(files.required("task")), _SET_POINT_PERIOD)
        limits = load_controller(files.controller).limits(model)
        self._delivery = Delivery(controller, 0.0, limits, _SET_POINT_PERIOD, _APPROACH)
        self._group = ProcessGroup()
        self._cell: ChildProcess | None = None
        self._view: LiveView | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._send_again_and_again, name="tour", daemon=True)

    def start(self) -> None:
        """Start the nodes; the arm stands straight up."""
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        print(f"starting simulation and controller; in another terminal: export ROS_DOMAIN_ID={domain}", flush=True)
        self._cell = self._group.start(
            "nodes", executable("rx90_cell", "--ros-args", "-p", f"robot:={self._robot}")
        )  # fmt: skip

    def follow(self, page: Page, view: LiveView, started: Callable[[], None]) -> None:
        """Move the arm from now on, call `started` when it is seen; the page ends with an error when the nodes do."""
        self._view = view

        def check(_now: float) -> None:
            assert self._cell is not None
            if self._cell.returncode is not None:
                self._cell.wait_for("$^")  # says that it has ended, and its last line
            if view.state is not None:
                started()

        page.every(_LOOK, check)
        self._thread.start()

    def end(self) -> None:
        """End thread and nodes."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join(_TIMEOUT)
        self._group.__exit__()

    def _leave_at_the_end(self) -> None:
        if self._ending.is_set():
            raise ExchangeError("the page has ended")

    def _send_again_and_again(self) -> None:
        said = ""
        while not self._ending.is_set():
            try:
                with client_node("rx90_view_line", _TIMEOUT, lambda _: None) as client:
                    leaving = replace(client, check_interrupt=self._leave_at_the_end)
                    deliver(leaving, self._plan, self._delivery)
            except Rx90Error as error:  # torque off, somebody else's motion: the next time it may go
                if str(error) != said and not self._ending.is_set():
                    said = str(error)
                    print(f"rx90_view: the line was not sent: {said}", flush=True)
            self._ending.wait(_REST)
            while not self._ending.wait(_LOOK) and not self._rests():
                pass

    def _rests(self) -> bool:
        """Tell whether the trajectory that was accepted last is over."""
        assert self._view is not None
        return self._view.rests(_REST)
