"""The node of a program with requests to the running nodes: messages and answers arrive while it waits.

Services are also called without waiting: the result of a call is given to its caller, at the latest after a timeout.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import rclpy
from rcl_interfaces.msg import Log
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.node import Node
from rclpy.task import Future

from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.interrupts import deferred_interrupts

POLL = 0.05
"""The longest time without a look for Ctrl-C, s."""
_LINES = 100  # messages kept
_ARTICLE = re.compile("^(an?|the) ")


@dataclass(frozen=True)
class ClientNode:
    """A node whose messages are received by `spin`, on the caller's thread.

    Attributes:
        node: for publishers, subscriptions and service clients.
        executor: one that has the node.
        timeout: longest wait for another node, s.
        say: prints a line for the user.
        check_interrupt: called in each `spin`; may raise.
    """

    node: Node
    executor: Executor
    timeout: float
    say: Callable[[str], None]
    check_interrupt: Callable[[], None]

    def spin(self, longest: float = POLL) -> None:
        """Take a message or an answer, or wait for one, at most so many seconds."""
        self.executor.spin_once(timeout_sec=longest)
        self.check_interrupt()

    def wait(self, ready: Callable[[], bool], what: str, more: Callable[[], float] = float) -> None:
        """Spin until `ready`; print once that the program waits for `what`.

        Args:
            ready: returns whether it is there.
            what: in words.
            more: called once, after the timeout: returns the additional time to wait, s.

        Raises:
            ExchangeError: after the timeout.
        """
        allowed = self.timeout
        begin = time.monotonic()
        if not ready():
            self.say(f"waiting for {what}")
        while not ready():
            if time.monotonic() >= begin + allowed:
                allowed += more()
                more = float
            if time.monotonic() >= begin + allowed:
                raise ExchangeError(f"found no {_ARTICLE.sub('', what)} within {allowed:g} s")
            self.spin()

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service of type `kind` and return its answer.

        Raises:
            ExchangeError: if the service is not there or does not answer within the timeout.
        """
        caller = self.node.create_client(kind, service)
        try:
            self.wait(caller.service_is_ready, f"a service {caller.srv_name}")
            answer = caller.call_async(request)
            self.wait(answer.done, f"an answer of {caller.srv_name}")
            return answer.result()
        finally:  # each client that is left makes every later wait longer
            self.node.destroy_client(caller)


@contextmanager
def client_node(
    name: str, timeout: float, say: Callable[[str], None], ros_args: Sequence[str] = ()
) -> Iterator[ClientNode]:
    """Start ROS in a context of its own, with a node in it; Ctrl-C within the block is raised by `ClientNode.spin`."""
    if not (math.isfinite(timeout) and timeout > 0.0):
        raise ConfigError(f"the timeout is {timeout:g} s; accepted: a number > 0")
    context = Context()
    with deferred_interrupts() as check_interrupt:
        start_ros(ros_args, context)
        try:
            node = rclpy.create_node(name, context=context)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(node)
            try:
                yield ClientNode(node, executor, timeout, say, check_interrupt)
            finally:
                executor.shutdown()
                node.destroy_node()
        finally:
            context.try_shutdown()


class ServiceRequest(NamedTuple):
    """A request to a service.

    Attributes:
        kind: type of the service.
        service: its name.
        request: of that type.
        read: returns the result in an answer; raises ExchangeError for a refusal.
    """

    kind: Any
    service: str
    request: Any
    read: Callable[[Any], str]


Outcome = Callable[["str | ExchangeError"], None]
"""Called with the result of a call, or with the reason why there is none, or a refusal."""


class ServiceCalls:
    """Calls of services that go on while `ClientNode.spin` is called; `look` is to be called as often.

    Args:
        client: the node; its timeout is the longest wait for an answer.
    """

    def __init__(self, client: ClientNode) -> None:
        self._client = client
        self._callers: dict[str, Client] = {}
        self._open: list[
            tuple[ServiceRequest, Future, float, Outcome]
        ] = []  # with the latest time of the answer

    def ask(self, request: ServiceRequest, then: Outcome) -> None:
        """Call a service; `then` is called with the result."""
        if request.service not in self._callers:
            self._callers[request.service] = self._client.node.create_client(
                request.kind, request.service
            )
        caller = self._callers[request.service]
        if caller.service_is_ready():
            deadline = time.monotonic() + self._client.timeout
            self._open.append((request, caller.call_async(request.request), deadline, then))
        else:
            then(
                ExchangeError(
                    f"there is no service {caller.srv_name}; accepted: while its node runs"
                )
            )

    def look(self) -> None:
        """Deliver the answers that have arrived, and report calls that have timed out."""
        now = time.monotonic()
        calls = self._open
        self._open = []
        for call in calls:
            request, answer, deadline, then = call
            outcome: str | ExchangeError
            if answer.done():
                try:
                    outcome = request.read(answer.result())
                except ExchangeError as error:
                    outcome = error
            elif now >= deadline:
                caller = self._callers[request.service]
                caller.remove_pending_request(answer)
                outcome = ExchangeError(
                    f"no answer of {caller.srv_name} within {self._client.timeout:g} s"
                )
            else:
                self._open.append(call)
                continue
            then(outcome)


def spoken(service: str) -> Callable[[Any], str]:
    """Return the reader of an answer with `success` and `message`."""

    def read(answer: Any) -> str:
        if not answer.success:
            raise ExchangeError(f"{service}: {answer.message}")
        return str(answer.message)

    return read


def subscribe_log(
    client: ClientNode, nodes: Sequence[str], heard: Callable[[str, str, bool], None]
) -> None:
    """Call `heard` with each line that one of some nodes logs from now on.

    Args:
        client: the node that subscribes.
        nodes: their names, relative to its namespace or absolute.
        heard: called with the name as in `nodes`, the line, and whether that is a warning or an error, within
            `ClientNode.spin`.
    """
    # A log bears the absolute name without the first slash, and with dots for the others.
    names = {
        client.node.resolve_topic_name(name).strip("/").replace("/", "."): name for name in nodes
    }

    def take(line: Log) -> None:
        if line.name in names:
            heard(names[line.name], str(line.msg), line.level >= LoggingSeverity.WARN)

    client.node.create_subscription(Log, "/rosout", take, _LINES)
