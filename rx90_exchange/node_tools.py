"""What both nodes share: parameters with descriptors, diagnostics, the frame around their two threads."""

from __future__ import annotations

import contextlib
import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from rx90_common.errors import ConfigError
from rx90_exchange.qos import CLOCK_QOS

_SPIN_SLICE = 0.2
_SETTLED_LOOKS = 10  # of 50 ms
_SWITCH_INTERVAL = 5e-4
_Value = TypeVar("_Value", bool, int, float, str, list[float])


def declare(
    node: Node,
    name: str,
    default: _Value,
    description: str,
    *,
    low: float | None = None,
    high: float | None = None,
    read_only: bool = True,
) -> _Value:
    """Declare a parameter with its descriptor and return its value.

    Raises:
        ConfigError: naming parameter, value and accepted range.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if low is not None and high is not None:
        if isinstance(default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        else:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    try:
        value: Any = node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        override = node._parameter_overrides.get(name)  # rclpy names neither value nor range in a way to show
        given = getattr(override, "value", None)
        accepted = type(default).__name__ if low is None else f"{type(default).__name__} in [{low:g}, {high:g}]"
        raise ConfigError(f"parameter {name} is {given!r}; accepted: {accepted}") from error
    return value  # type: ignore[no-any-return]


class Diagnostics:
    """One status on /diagnostics, once a second.

    Args:
        node: the publisher's node.
        collect: returns the level (OK, WARN or ERROR of DiagnosticStatus), the message and the values.
    """

    def __init__(self, node: Node, collect: Callable[[], tuple[bytes, str, dict[str, str]]]) -> None:
        self._node = node
        self._collect = collect
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", CLOCK_QOS)
        self._timer = node.create_timer(1.0, self._publish)

    def _publish(self) -> None:
        level, message, values = self._collect()
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_name(),
            message=message,
            hardware_id="rx90_emulator",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)


class TickingNode(Protocol):
    """A node with a thread of its own for the ticks."""

    node: Node

    def tick_loop(self) -> None:
        """Run ticks until `stop` is called; errors end the program."""

    def stop(self) -> None:
        """End `tick_loop` soon; callable from every thread."""


def spin(
    make: Callable[[], TickingNode],
    args: Sequence[str],
    make_executor: Callable[[], Executor] = SingleThreadedExecutor,
) -> None:
    """Run a ticking node: ticks on a thread of their own, everything slow on an executor in this one.

    A node whose services wait for something brings an executor with threads of its own.

    Raises:
        Rx90Error: what the node's constructor or its ticks raise.
    """
    with _rclpy(args):
        ticking = make()
        failures: list[BaseException] = []
        thread = threading.Thread(target=_guard, args=(ticking.tick_loop, failures), name="ticks", daemon=True)
        executor = make_executor()
        executor.add_node(ticking.node)
        # The executor must give the interpreter back to the ticks soon, and the collector must not walk through
        # everything that was imported in the middle of a tick.
        sys.setswitchinterval(_SWITCH_INTERVAL)
        gc.collect()
        gc.freeze()
        stopped = _stop_request()
        thread.start()
        try:
            while thread.is_alive() and not stopped.is_set():
                executor.spin_once(timeout_sec=_SPIN_SLICE)
        finally:
            ticking.stop()
            thread.join(5.0)
            executor.shutdown()
            ticking.node.destroy_node()
        if failures:
            raise failures[0]


def _stop_request() -> threading.Event:
    """Return what Ctrl-C and SIGTERM set from now on; as often as they come, the end stays in order."""
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _signal, _frame: stopped.set())
    return stopped


def _guard(run: Callable[[], None], failures: list[BaseException]) -> None:
    try:
        run()
    except BaseException as error:
        failures.append(error)


@contextlib.contextmanager
def _rclpy(args: Sequence[str]) -> Iterator[None]:
    try:
        # `spin` handles Ctrl-C and ends everything in order; rclpy would pull the context away first.
        # rcl would print a refusal itself, beside the line that the error becomes.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = " ".join(str(error).split(", at /")[0].split())
        raise ConfigError(f"ROS arguments {' '.join(args)}: refused ({reason})") from error
    set_logger_level("rcl", LoggingSeverity.UNSET)
    try:
        yield
    finally:
        try_shutdown()


def wait_until_matched(node: Node, topics: Sequence[str], matched: Callable[[], list[int]], attempts: int) -> bool:
    """Wait until every subscription that the graph knows of is matched with our publishers.

    A recorder that was started before then gets the first message too. The graph learns of its members one by one, so
    it must also have stayed as it is for half a second.

    Args:
        node: the publishers' node.
        topics: resolved names of the topics.
        matched: matched subscriptions of each topic now.
        attempts: how often to look, 50 ms apart.
    """
    pause = threading.Event()
    before: list[int] = []
    quiet = 0
    for _ in range(attempts):
        known, have = [node.count_subscribers(topic) for topic in topics], matched()
        complete = all(h >= k for h, k in zip(have, known, strict=True))
        quiet = quiet + 1 if complete and have == before else 0
        if quiet >= _SETTLED_LOOKS:
            return True
        before = have
        pause.wait(0.05)
    return False
