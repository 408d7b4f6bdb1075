"""The node of a program that asks the running nodes for something: messages and answers come in while it waits."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.interrupts import interrupts_later

POLL = 0.05
"""The longest time without a look for Ctrl-C, s."""


@dataclass(frozen=True)
class ClientNode:
    """A node whose messages are taken by `spin`, on the caller's thread.

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

    def wait(self, ready: Callable[[], bool], what: str) -> None:
        """Spin until `ready`; say once that `what` is waited for.

        Raises:
            ExchangeError: after the timeout.
        """
        deadline = time.monotonic() + self.timeout
        if not ready():
            self.say(f"waiting for {what}")
        while not ready():
            if time.monotonic() >= deadline:
                raise ExchangeError(f"found no {what.removeprefix('a ')} within {self.timeout:g} s")
            self.spin()

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service of type `kind` and return its answer.

        Raises:
            ExchangeError: if the service is not there or does not answer within the timeout.
        """
        caller = self.node.create_client(kind, service)
        self.wait(caller.service_is_ready, f"a service {caller.srv_name}")
        answer = caller.call_async(request)
        self.wait(answer.done, f"an answer of {caller.srv_name}")
        return answer.result()


@contextmanager
def client_node(
    name: str, timeout: float, say: Callable[[str], None], ros_args: Sequence[str] = ()
) -> Iterator[ClientNode]:
    """Start ROS in a context of its own, with a node in it; Ctrl-C within the block is raised by `ClientNode.spin`.

    Raises:
        ConfigError: if the timeout is no time, or ROS refuses the arguments or the environment.
    """
    if not (math.isfinite(timeout) and timeout > 0.0):
        raise ConfigError(f"the timeout is {timeout:g} s; accepted: a number > 0")
    context = Context()
    with interrupts_later() as check_interrupt:
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
