"""What the page asks of running nodes without waiting: services, trajectories, a start with other friction."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import replace

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import (
    ClientNode,
    NodeWatch,
    ServiceCalls,
    ServiceRequest,
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
_MESSAGES = 5  # that are taken in one step at most, so that the page goes on
_PATH = {  # transitions from each state to unconfigured
    "active": ("deactivate", "cleanup"),
    "inactive": ("cleanup",),
    "unconfigured": (),
}
_Requests = Generator[ServiceRequest, str | None, None]
_Ended = Callable[[str, bool], None]


class Operator:
    """Hands requests to the nodes; every method returns at once, and `step` takes in what the nodes say.

    Args:
        client: the node that asks them.
        controller: name of the controller node, relative or absolute; the simulation is in its namespace.
        heard: takes the name of a node, a line, and whether it is a refusal or a failure.
        timeout: the longest wait for an answer, s.

    Attributes:
        simulation, controller: the nodes' names.
    """

    def __init__(
        self, client: ClientNode, controller: str, heard: Callable[[str, str, bool], None], timeout: float = TIMEOUT
    ) -> None:
        self.simulation, self.controller = f"{controller[: controller.rfind('/') + 1]}rx90_sim", controller
        self._heard, self._client = heard, replace(client, timeout=timeout)
        self._calls = ServiceCalls(self._client)
        self._trajectories = TrajectoryClient(self._client, controller)
        nodes = self.simulation, self.controller
        self._watches = [NodeWatch(self._client, self._calls, name) for name in nodes]
        hear_log(self._client, nodes, self._log_line)
        self._answer_by: float | None = None  # when the controller must have said something of a trajectory
        self._next_look = 0.0

    @property
    def states(self) -> dict[str, str]:
        """Return the lifecycle states of simulation and controller by their names; empty for a node that is absent."""
        return {self.simulation: self._watches[0].state, self.controller: self._watches[1].state}

    def step(self, now: float) -> None:
        """Take in messages and answers; to be called often, with the steady clock's time, s."""
        for _ in range(_MESSAGES):
            self._client.spin(0.0)
        self._calls.look()
        if now >= self._next_look:
            self._next_look = now + _LOOKS
            for watch in self._watches:
                watch.look()
        if self._answer_by is not None and now >= self._answer_by:
            self._answer_by = None
            text = f"has said nothing of the trajectory within {self._client.timeout:g} s"
            self._heard(self.controller, text, True)

    def ask(self, request: ServiceRequest) -> None:
        """Call a service; what it says, or that it says nothing, is heard."""

        def only() -> _Requests:
            yield request

        self._ask_in_turn(request.service.rpartition("/")[0], only())

    def send(self, joints: tuple[str, ...], points: TrajectoryPoints | None) -> None:
        """Have a trajectory followed that starts now, or stop the arm for None; the controller's log line is heard."""
        try:
            self._trajectories.offer(joints, points)
            self._answer_by = self._answer_by or time.monotonic() + self._client.timeout
        except ExchangeError as error:
            self._heard(self.controller, str(error), True)

    def start_again_with(self, parameter: str, value: str, ended: _Ended) -> None:
        """Set a parameter of the simulation that is read at its start, and start it again, at time 0.

        `ended` takes how that went and whether it went wrong.
        """
        node = self.simulation

        def requests() -> _Requests:
            # Asked for: what was heard of its transitions may be older than the answer to the last one.
            state = yield state_request(node)
            if state not in _PATH:
                raise ExchangeError(f"its state is {state}; accepted: a simulation that runs")
            yield from (transition_request(node, label) for label in _PATH[state])
            yield parameter_request(node, parameter, value)
            yield from (transition_request(node, label) for label in ("configure", "activate"))

        def tell(text: str, wrong: bool) -> None:
            ended(f"{node} {'is not started again' if wrong else 'runs again, from time 0'}: {text}", wrong)

        self._ask_in_turn(node, requests(), tell)

    def _ask_in_turn(self, node: str, requests: _Requests, ended: _Ended = lambda _text, _wrong: None) -> None:
        """Call services, each after the one before it has said yes; what the last one says, or the first no, is heard.

        The requests get what each says.
        """

        def proceed(outcome: str | ExchangeError) -> None:
            try:
                if isinstance(outcome, ExchangeError):
                    raise outcome
                request = requests.send(outcome or None)
            except (StopIteration, ExchangeError) as end:
                wrong = isinstance(end, ExchangeError)
                text = str(end if wrong else outcome)
                self._heard(node, text, wrong)
                ended(text, wrong)
            else:
                self._calls.ask(request, proceed)

        proceed("")

    def _log_line(self, node: str, line: str, wrong: bool) -> None:
        if node == self.controller:
            self._answer_by = None
        self._heard(node, line, wrong)
