"""What the page asks of running nodes, on a thread of its own, with its buttons and the lines that come back."""

from __future__ import annotations

import html
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from viser import GuiButtonHandle

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import (
    NodeWatch,
    Outcome,
    ServiceCalls,
    ServiceRequest,
    client_node,
    hear_log,
    parameter_request,
    state_request,
    transition_request,
)
from rx90_controller.node.trajectory_client import TrajectoryClient, enable_request
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.view.page import Page, block
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

_ACTIVE = ("active",)
_CONFIGURED = ("active", "inactive")

TIMEOUT = 5.0
"""The longest wait for an answer, s."""
_LOOKS = 0.5  # s from one look at which nodes there are to the next
_LONGEST_WAIT = 0.25  # s for a message; what is asked does not wait for it
_PATH = {  # transitions from each state to unconfigured
    "active": ("deactivate", "cleanup"),
    "inactive": ("cleanup",),
    "unconfigured": (),
}


@dataclass(frozen=True)
class NodeNames:
    """Names of the two nodes that are asked, relative or absolute, and arguments for the node that asks them."""

    simulation: str = "rx90_sim"
    controller: str = "rx90_controller"
    ros_args: tuple[str, ...] = ()

    @classmethod
    def beside(cls, controller: str, ros_args: Sequence[str]) -> NodeNames:
        """Return a controller, relative or absolute, and the simulation in its namespace."""
        return cls(f"{controller[: controller.rfind('/') + 1]}{cls.simulation}", controller, tuple(ros_args))


Said = Callable[[str, str, bool], None]
"""Takes the name of a node, a line, and whether it is a refusal or a failure."""
States = Callable[[str, str], None]
"""Takes the lifecycle states of simulation and controller; empty for a node that is not there."""


class Operator:
    """Hands requests to the nodes; every method returns at once.

    Args:
        names: of the nodes.
        said: takes what they say, on the operator's thread.
        states: takes their states when one has changed, likewise.
        timeout: the longest wait for an answer, s.
    """

    def __init__(self, names: NodeNames, said: Said, states: States, timeout: float = TIMEOUT) -> None:
        self.names, self._said, self._states, self._timeout = names, said, states, timeout
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._wake: Callable[[], object] = _nothing
        self._answer_by: float | None = None  # when the controller must have said something of a trajectory
        self._thread = threading.Thread(target=self._run, name="operator", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and leave the nodes."""
        self._ended.set()
        self._wake()
        self._thread.join()

    def ask(self, asked: ServiceRequest) -> None:
        """Call a service; what it says, or that it says nothing, is heard."""
        node = asked.service.rpartition("/")[0]

        def tell(outcome: str | ExchangeError) -> None:
            self._said(node, str(outcome), isinstance(outcome, ExchangeError))

        self._put(lambda: self._calls.ask(asked, tell))

    def send(self, joints: tuple[str, ...], points: TrajectoryPoints | None) -> None:
        """Have a trajectory followed that starts now, or stop the arm for None; the controller's log line is heard."""

        def publish() -> None:
            try:
                self._trajectories.offer(joints, points)
            except ExchangeError as error:
                self._said(self.names.controller, str(error), True)
            else:
                if self._answer_by is None:
                    self._answer_by = time.monotonic() + self._timeout

        self._put(publish)

    def configure_again(self, parameter: str, value: str, ended: Callable[[str, bool], None]) -> None:
        """Set a parameter of the simulation that is read at its start, and start it again, at time 0.

        `ended` takes how that went and whether it went wrong, on the operator's thread.
        """
        node = self.names.simulation

        def tell(outcome: str | ExchangeError) -> None:
            wrong = isinstance(outcome, ExchangeError)
            self._said(node, str(outcome), wrong)
            ended(f"{node} {'is not started again' if wrong else 'runs again, from time 0'}: {outcome}", wrong)

        def begin(state: str | ExchangeError) -> None:
            if isinstance(state, ExchangeError) or state not in _PATH:
                known = "unknown" if isinstance(state, ExchangeError) else state
                tell(ExchangeError(f"its state is {known}; accepted: a simulation that runs"))
                return
            steps = [transition_request(node, label) for label in _PATH[state]]
            steps.append(parameter_request(node, parameter, value))
            steps += [transition_request(node, label) for label in ("configure", "activate")]
            self._one_by_one(steps, tell)

        # Asked for: what was heard of its transitions may be older than the answer to the last one.
        self._put(lambda: self._calls.ask(state_request(node), begin))

    def _one_by_one(self, steps: list[ServiceRequest], tell: Outcome) -> None:
        """Call services, each after the one before it has said yes; tell the last one's answer, or the first no."""

        def then(outcome: str | ExchangeError) -> None:
            if isinstance(outcome, ExchangeError) or len(steps) == 1:
                tell(outcome)
            else:
                self._one_by_one(steps[1:], tell)

        self._calls.ask(steps[0], then)

    def _put(self, request: Callable[[], None]) -> None:
        self._waiting.put(request)
        self._wake()

    def _run(self) -> None:
        names = self.names.simulation, self.names.controller
        with client_node("rx90_view_panel", self._timeout, lambda _line: None, self.names.ros_args) as client:
            self._calls = ServiceCalls(client)
            self._trajectories = TrajectoryClient(client, self.names.controller)
            simulation, controller = watches = [NodeWatch(client, self._calls, name) for name in names]
            hear_log(client, names, self._log_line)
            # The executor's own `wake` does not end a wait.
            self._wake = lambda: client.executor.create_task(_nothing)
            known, next_look = None, 0.0
            while not self._ended.is_set():
                while not self._waiting.empty():
                    self._waiting.get()()
                client.spin(_LONGEST_WAIT)
                self._calls.look()
                now = time.monotonic()
                if now >= next_look:
                    next_look = now + _LOOKS
                    for watch in watches:
                        watch.look()
                if known != (known := (simulation.state, controller.state)):
                    self._states(*known)
                if self._answer_by is not None and now >= self._answer_by:
                    self._answer_by = None
                    text = f"has said nothing of the trajectory within {self._timeout:g} s"
                    self._said(self.names.controller, text, True)
            self._wake = _nothing

    def _log_line(self, node: str, line: str, wrong: bool) -> None:
        if node == self.names.controller:
            self._answer_by = None
        self._said(node, line, wrong)


def _nothing() -> None:
    pass


class NodeControls:
    """Buttons that are enabled while their node can do what they ask for; a line says why the others are not.

    Args:
        page: to build in, within a tab.
        operator: asks the nodes.

    Attributes:
        simulation, controller: the lifecycle states; empty for a node that is not there.
    """

    def __init__(self, page: Page, operator: Operator) -> None:
        self._page, self._operator = page, operator
        self.simulation = self.controller = ""
        self._buttons: list[tuple[GuiButtonHandle, bool, tuple[str, ...]]] = []
        self._state = page.gui.add_html("")
        node = operator.names.simulation
        self._button("Pause", pause_request(node, paused=True), _CONFIGURED)
        self._button("Run", pause_request(node, paused=False), _CONFIGURED)
        self._button("Step", step_request(node), _ACTIVE)
        self._button("Reset to time 0", reset_request(node), _CONFIGURED)
        node = operator.names.controller
        self._button("Torque on", enable_request(node, on=True), _ACTIVE)
        self._button("Torque off, brakes closed", enable_request(node, on=False), _ACTIVE)
        self.states("", "")

    def states(self, simulation: str, controller: str) -> None:
        """Take the lifecycle states."""
        self.simulation, self.controller = simulation, controller
        for button, of_simulation, accepted in self._buttons:
            button.disabled = (simulation if of_simulation else controller) not in accepted
        names = self._operator.names
        lines = [_state_line(names.simulation, simulation), _state_line(names.controller, controller)]
        self._state.content = block("<br>".join(lines))

    def _button(self, label: str, asked: ServiceRequest, accepted: tuple[str, ...]) -> None:
        button = self._page.gui.add_button(label)
        button.on_click(lambda _: self._operator.ask(asked))
        of_simulation = asked.service.startswith(f"{self._operator.names.simulation}/")
        self._buttons.append((button, of_simulation, accepted))


def _state_line(node: str, state: str) -> str:
    said = html.escape(state) if state else f"not there: its buttons wait for <code>{html.escape(node)}</code> to start"
    return f"<b>{html.escape(node)}</b> {said}"
