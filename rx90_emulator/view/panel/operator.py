"""Asks the running nodes for things, on a thread of its own: neither the page nor who reads waits for an answer."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints

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


@dataclass(frozen=True)
class Heard:
    """Where what the nodes say goes; called on the operator's thread.

    Attributes:
        said: takes the name of a node, a line, and whether it is a refusal or a failure.
        states: takes the lifecycle states of simulation and controller when one of them has changed; empty: not there.
    """

    said: Callable[[str, str, bool], None]
    states: Callable[[str, str], None]


class Operator:
    """Hands requests to the nodes; every method returns at once.

    Args:
        names: of the nodes.
        heard: takes what they say.
        timeout: the longest wait for an answer, s.
    """

    def __init__(self, names: NodeNames, heard: Heard, timeout: float = TIMEOUT) -> None:
        self.names, self._heard, self._timeout = names, heard, timeout
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
                self._heard.said(self.names.controller, str(error), True)
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
            self._heard.said(node, str(outcome), wrong)
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
            nodes = _NodeClients(client, self.names, self._heard)
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

    def __init__(self, client: ClientNode, names: NodeNames, heard: Heard) -> None:
        self._names, self._heard, self._timeout = names, heard, client.timeout
        self.calls = ServiceCalls(client)
        self.trajectories = TrajectoryClient(client, names.controller)
        self.simulation, self.controller = (
            NodeWatch(client, self.calls, name) for name in (names.simulation, names.controller)
        )
        hear_log(client, (names.simulation, names.controller), self._log_line)
        self._told: tuple[str, str] | None = None
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
        if states != self._told:
            self._told = states
            self._heard.states(*states)
        if self._answer_by is not None and now >= self._answer_by:
            self._answer_by = None
            text = f"has said nothing of the trajectory within {self._timeout:g} s"
            self._heard.said(self._names.controller, text, True)

    def expect_answer(self) -> None:
        """Complain if the controller logs nothing within the timeout."""
        if self._answer_by is None:
            self._answer_by = time.monotonic() + self._timeout

    def tell(self, service: str) -> Outcome:
        """Return what tells how a call has ended."""
        node = service.rpartition("/")[0]

        def tell(outcome: str | ExchangeError) -> None:
            self._heard.said(node, str(outcome), isinstance(outcome, ExchangeError))

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
        self._heard.said(node, line, wrong)


def _nothing() -> None:
    pass
