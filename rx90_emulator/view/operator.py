"""What the page asks of running nodes, on a thread of its own, with its buttons and the lines that come back."""

from __future__ import annotations

import html
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from viser import GuiButtonHandle

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import (
    ClientNode,
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

_LINES = 6
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
        self._waiting: queue.SimpleQueue[Callable[[_NodeClients], None]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._wake: Callable[[], object] = _nothing
        self._thread = threading.Thread(target=self._run, name="operator", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and leave the nodes."""
        self._ended.set()
        self._wake()
        self._thread.join()

    def ask(self, asked: ServiceRequest) -> None:
        """Call a service; what it says, or that it says nothing, is heard."""
        self._put(lambda nodes: nodes.calls.ask(asked, nodes.tell(asked.service)))

    def send(self, joints: tuple[str, ...], points: TrajectoryPoints | None) -> None:
        """Have a trajectory followed that starts now, or stop the arm for None; the controller's log line is heard."""

        def publish(nodes: _NodeClients) -> None:
            try:
                nodes.trajectories.offer(joints, points)
            except ExchangeError as error:
                self._said(self.names.controller, str(error), True)
            else:
                nodes.expect_answer()

        self._put(publish)

    def configure_again(self, parameter: str, value: str, ended: Callable[[str, bool], None]) -> None:
        """Set a parameter of the simulation that is read at its start, and start it again, at time 0.

        `ended` takes how that went and whether it went wrong, on the operator's thread.
        """
        node = self.names.simulation

        def told(outcome: str | ExchangeError) -> None:
            wrong = isinstance(outcome, ExchangeError)
            self._said(node, str(outcome), wrong)
            ended(f"{node} {'is not started again' if wrong else 'runs again, from time 0'}: {outcome}", wrong)

        def begin(nodes: _NodeClients, state: str | ExchangeError) -> None:
            if isinstance(state, ExchangeError) or state not in _PATH:
                known = "unknown" if isinstance(state, ExchangeError) else state
                told(ExchangeError(f"its state is {known}; accepted: a simulation that runs"))
                return
            steps = [transition_request(node, label) for label in _PATH[state]]
            steps.append(parameter_request(node, parameter, value))
            steps += [transition_request(node, label) for label in ("configure", "activate")]
            nodes.one_by_one(steps, told)

        # Asked for: what was heard of its transitions may be older than the answer to the last one.
        self._put(lambda nodes: nodes.calls.ask(state_request(node), lambda state: begin(nodes, state)))

    def _put(self, request: Callable[[_NodeClients], None]) -> None:
        self._waiting.put(request)
        self._wake()

    def _run(self) -> None:
        with client_node("rx90_view_panel", self._timeout, lambda _line: None, self.names.ros_args) as client:
            nodes = _NodeClients(client, self.names, self._said, self._states)
            # The executor's own `wake` does not end a wait.
            self._wake = lambda: client.executor.create_task(_nothing)
            while not self._ended.is_set():
                while not self._waiting.empty():
                    self._waiting.get()(nodes)
                client.spin(_LONGEST_WAIT)
                nodes.look()
            self._wake = _nothing


class _NodeClients:
    """The clients of both nodes, and what is still to be answered; for the operator's thread alone."""

    def __init__(self, client: ClientNode, names: NodeNames, said: Said, states: States) -> None:
        self._names, self._said, self._states, self._timeout = names, said, states, client.timeout
        self.calls = ServiceCalls(client)
        self.trajectories = TrajectoryClient(client, names.controller)
        self.simulation, self.controller = (
            NodeWatch(client, self.calls, name) for name in (names.simulation, names.controller)
        )
        hear_log(client, (names.simulation, names.controller), self._log_line)
        self._last_states: tuple[str, str] | None = None
        self._next_look = 0.0
        self._answer_by: float | None = None

    def look(self) -> None:
        """Do what is due."""
        now = time.monotonic()
        self.calls.look()
        if now >= self._next_look:
            self._next_look = now + _LOOKS
            self.simulation.look()
            self.controller.look()
        states = self.simulation.state, self.controller.state
        if states != self._last_states:
            self._last_states = states
            self._states(*states)
        if self._answer_by is not None and now >= self._answer_by:
            self._answer_by = None
            text = f"has said nothing of the trajectory within {self._timeout:g} s"
            self._said(self._names.controller, text, True)

    def expect_answer(self) -> None:
        """Complain if the controller logs nothing within the timeout."""
        if self._answer_by is None:
            self._answer_by = time.monotonic() + self._timeout

    def tell(self, service: str) -> Outcome:
        """Return what tells how a call has ended."""
        node = service.rpartition("/")[0]

        def tell(outcome: str | ExchangeError) -> None:
            self._said(node, str(outcome), isinstance(outcome, ExchangeError))

        return tell

    def one_by_one(self, steps: list[ServiceRequest], told: Outcome) -> None:
        """Call services, each after the one before it has said yes; the last one's answer, or the first no, is told."""

        def then(outcome: str | ExchangeError) -> None:
            if isinstance(outcome, ExchangeError) or len(steps) == 1:
                told(outcome)
            else:
                self.one_by_one(steps[1:], told)

        self.calls.ask(steps[0], then)

    def _log_line(self, node: str, line: str, wrong: bool) -> None:
        if node == self._names.controller:
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


class NodeLog:
    """The newest lines of what the nodes say and of what was refused here."""

    def __init__(self, page: Page) -> None:
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._shown = page.gui.add_html(block("nothing yet"))

    def say(self, who: str, text: str, wrong: bool) -> None:
        """Show a line."""
        colour = "color:#c92a2a" if wrong else ""
        self._lines.appendleft(f'<div style="{colour}"><b>{html.escape(who)}</b> {html.escape(text)}</div>')
        self._shown.content = block("".join(self._lines))


def _state_line(node: str, state: str) -> str:
    said = html.escape(state) if state else f"not there: its buttons wait for <code>{html.escape(node)}</code> to start"
    return f"<b>{html.escape(node)}</b> {said}"
