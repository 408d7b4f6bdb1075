"""The frame around nodes that tick: threads for the ticks, an executor for everything slow, diagnostics."""

from __future__ import annotations

import gc
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import Protocol

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import Executor, ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from rx90_common.exchange.endpoints import CLOCK_QOS, publish
from rx90_common.exchange.pacing import ThrottledLog
from rx90_common.exchange.parameters import answer_all_requests, refuse_unknown_parameters
from rx90_common.exchange.ros_start import reason, start_ros
from rx90_common.process.interrupts import stop_request

_SPIN_SLICE = 0.2  # s
_SWITCH_INTERVAL = 5e-4  # s
_LAST_TICK_S = 5.0  # the longest wait for the end of a ticking thread


class Diagnostics:
    """One status on /diagnostics, once a second.

    Args:
        node: the publisher's node.
        collect: returns the level (OK, WARN or ERROR of DiagnosticStatus), the message and the values.
    """

    def __init__(self, node: Node, collect: Callable[[], tuple[bytes, str, dict[str, str]]]) -> None:
        self._node, self._collect = node, collect
        self._publisher = publish(node, DiagnosticArray, "/diagnostics", CLOCK_QOS.profile)
        # Without the leading slash, as diagnostic_aggregator writes names.
        namespace = node.get_namespace().strip("/")
        self._prefix = f"{namespace}/" if namespace else ""
        self._timer = node.create_timer(1.0, self._publish)

    def _publish(self) -> None:
        level, message, values = self._collect()
        status = DiagnosticStatus(
            level=level,
            name=self._prefix + self._node.get_name(),
            message=message,
            hardware_id=f"{self._prefix}rx90_emulator",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)


class TickingNode(Protocol):
    """A node with a thread of its own for the ticks."""

    @property
    def node(self) -> Node:
        """The node, for the executor."""

    def tick_loop(self) -> None:
        """Run ticks until `stop` is called; errors end the program."""

    def stop(self) -> None:
        """End `tick_loop` soon; callable from every thread."""


def spin(
    make: Callable[[], Sequence[TickingNode]],
    args: Sequence[str],
    make_executor: Callable[[], Executor] | None = None,
) -> None:
    """Run ticking nodes: ticks on threads of their own, everything slow on an executor in this one.

    The first node that ends, ends all. A node whose services wait for something brings an executor with threads of its
    own; several nodes have one for each, so that a service of one does not keep the others waiting.

    Raises:
        Rx90Error: what the nodes' constructors or their ticks raise.
    """
    start_ros(args)
    try:
        _spin(make(), make_executor)
    finally:
        try_shutdown()


def _spin(members: Sequence[TickingNode], make_executor: Callable[[], Executor] | None) -> None:
    nodes = [member.node for member in members]
    refuse_unknown_parameters(nodes)
    failures: list[BaseException] = []

    def run(tick_loop: Callable[[], None]) -> None:
        try:
            tick_loop()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=run, args=(one.tick_loop,), name="ticks", daemon=True) for one in members]
    if make_executor is not None:
        executor = make_executor()
    else:
        executor = SingleThreadedExecutor() if len(nodes) == 1 else MultiThreadedExecutor(len(nodes))
    for node in nodes:
        answer_all_requests(node)
        executor.add_node(node)
    # The executor must give the interpreter back to the ticks soon, and the collector must not walk through
    # everything that was imported in the middle of a tick.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    stopped = stop_request()
    log = ThrottledLog(lambda text: nodes[0].get_logger().error(text))
    for thread in threads:
        thread.start()
    try:
        while all(thread.is_alive() for thread in threads) and not stopped.is_set():
            _spin_once(executor, log)
    finally:
        # The simulation comes first: what its last tick has brought about is sent before the controller ends.
        for member, thread in zip(members, threads, strict=True):
            member.stop()
            thread.join(_LAST_TICK_S)
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
    if failures:
        raise failures[0]


def _spin_once(executor: Executor, log: ThrottledLog) -> None:
    """Serve what has come, or wait a moment; a request or a message that cannot be served is a line, not the end."""
    try:
        executor.spin_once(timeout_sec=_SPIN_SLICE)
    except ExternalShutdownException:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{PurePath(at.filename).name}:{at.lineno}"
        log.say(where, f"not served: {type(error).__name__} in {where}: {reason(error)}")
