"""The processes of nodes: threads for the ticks, an executor for slow work, diagnostics, and the lifecycle.

Managed nodes follow design.ros2.org/articles/node_lifecycle.html: this module has their states and transitions, and
starts and stops their ticks.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import PurePath
from typing import Any, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import try_shutdown

from rx90_common.base.errors import FAILED, Rx90Error
from rx90_common.base.quoting import one_line, plain
from rx90_common.exchange.channel import MakeChannel, TickChannel
from rx90_common.exchange.endpoints import CLOCK_QOS, TICK_QOS
from rx90_common.exchange.pacing import ThrottledLog, error_log
from rx90_common.exchange.parameters import (
    NodeParameters,
    ParameterChanges,
    named_parameters,
    unknown_parameter,
)
from rx90_common.exchange.requests import answer_all_requests
from rx90_common.exchange.ros_start import reason, start_ros
from rx90_common.process.interrupts import end_with, stop_request

_SPIN_SLICE = 0.2  # s
_SWITCH_INTERVAL = 5e-4  # s
_LAST_TICK_S = 5.0  # the longest wait for the end of a ticking thread
# after which a node that does not end is cut off: the middleware may wait for ever
_SHUTDOWN_S = 25.0
_ENTITIES = {  # what a configured node may have made, and the function that destroys it
    "publishers": "destroy_publisher",
    "subscriptions": "destroy_subscription",
    "clients": "destroy_client",
    "services": "destroy_service",
    "timers": "destroy_timer",
    "guards": "destroy_guard_condition",
}


def publish_diagnostics(
    node: Node, collect: Callable[[], tuple[bytes, str, dict[str, str]]]
) -> Callable[[], None]:
    """Publish one status of a node on /diagnostics, once a second of the wall clock, also while simulated time stands.

    Args:
        node: the publisher's node.
        collect: returns the level (OK, WARN or ERROR of DiagnosticStatus), the message and the values.

    Returns:
        What publishes it at once.
    """
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", CLOCK_QOS)
    # Without the leading slash, as diagnostic_aggregator writes names.
    prefix = f"{node.get_namespace()}/".lstrip("/")

    def publish() -> None:
        level, message, values = collect()
        status = DiagnosticStatus(
            level=level,
            name=prefix + node.get_name(),
            message=message,
            hardware_id=f"{prefix}rx90_emulator",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(array)

    node.create_timer(1.0, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
    return publish


class TickingNode(Protocol):
    """A node with a thread of its own for the ticks."""

    @property
    def node(self) -> Node:
        """The node, for the executor."""

    def tick_loop(self) -> None:
        """Run ticks until `stop` is called; errors end the program."""

    def stop(self) -> None:
        """End `tick_loop` soon; callable from every thread."""


def spin(make: Callable[[], Sequence[TickingNode]], args: Sequence[str], services: int = 1) -> None:
    """Run ticking nodes: ticks on threads of their own, everything slow on an executor in this one.

    All nodes end with the first one. An executor of several nodes has a thread for each, and more if a node has
    `services` that wait, so that one does not keep the others waiting.
    """
    cut_off = threading.Timer(_SHUTDOWN_S, _cut_off)
    cut_off.daemon = True
    start_ros(args)
    try:
        _spin(make(), services, cut_off)
    finally:
        try_shutdown()
        cut_off.cancel()


def _cut_off() -> None:
    print(f"not ended after {_SHUTDOWN_S:g} s: cut off", file=sys.stderr, flush=True)
    os._exit(FAILED)


def _spin(members: Sequence[TickingNode], services: int, cut_off: threading.Timer) -> None:
    nodes = [member.node for member in members]
    failures: list[BaseException] = []

    def run(tick_loop: Callable[[], None]) -> None:
        try:
            tick_loop()
        except BaseException as error:
            failures.append(error)

    threads = [
        threading.Thread(target=run, args=(one.tick_loop,), name="ticks", daemon=True)
        for one in members
    ]
    count = max(services, len(nodes))
    executor = SingleThreadedExecutor() if count == 1 else MultiThreadedExecutor(count)
    for node in nodes:
        answer_all_requests(node)
        executor.add_node(node)
    # The executor must give the interpreter back to the ticks soon, and the collector must not walk through
    # everything that was imported in the middle of a tick.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()
    stopped = stop_request()
    log = error_log(nodes[0])
    for thread in threads:
        thread.start()
    try:
        while all(thread.is_alive() for thread in threads) and not stopped.is_set():
            _spin_once(executor, log)
    finally:
        cut_off.start()
        # The simulation comes first: the results of its last tick are sent before the controller ends.
        for member, thread in zip(members, threads, strict=True):
            member.stop()
            thread.join(_LAST_TICK_S)
            # in the middleware, whose end would wait for this thread for ever
            if thread.is_alive():
                end_with(FAILED)
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
    if failures:
        raise failures[0]


def _spin_once(executor: Executor, log: ThrottledLog) -> None:
    """Handle what has arrived, or wait a moment; a failing request or message is logged and does not end the node."""
    try:
        executor.spin_once(timeout_sec=_SPIN_SLICE)
    except ExternalShutdownException:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{PurePath(at.filename).name}:{at.lineno}"
        log.say(where, f"not served: {type(error).__name__} in {where}: {reason(error)}")


class Managed(TickingNode, Protocol):
    """What a managed node is made of; the transitions are called on the executor's thread."""

    @property
    def node(self) -> ManagedNode:
        """The node, with the services."""

    def configure(self) -> None:
        """Load the node's parts by its parameters; raises Rx90Error. Their entities are destroyed at the cleanup."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Rest."""

    def cleanup(self) -> None:
        """Let go of all that was loaded; also after a `configure` that was refused."""


_Member = TypeVar("_Member", bound=Managed)


class ManagedNode(LifecycleNode):
    """The services of a managed node, and the effects of its states on its parameters and parts.

    Args:
        name: of the node.
        own_args: arguments for ROS that concern this node of its process alone.
        managed: carries out the transitions.
        make_channel: makes the node's end of the exchange.

    Attributes:
        parameters: that it was given, and declares.
        changes: answers requests to set parameters.
        ticking: the ticking thread, from a `configure` to the cleanup.
        starting: whether that is going on.
        error: why the last transition was refused, if it was.
    """

    def __init__(
        self, name: str, own_args: Sequence[str], managed: Managed, make_channel: MakeChannel
    ) -> None:
        with named_parameters():
            super().__init__(
                name, cli_args=list(own_args), automatically_declare_parameters_from_overrides=True
            )
        self._managed = managed
        self._make_channel = make_channel
        self._channel: TickChannel | None = None
        self.parameters = NodeParameters(self)
        self.changes = ParameterChanges(self, lambda: not self.configured)
        self.ticking = TickThread()
        self.starting = False
        self.error: Exception | None = None
        self._before: dict[str, set[Any]] = {}
        service = self._service_change_state
        service.callback = partial(self._change_state, service.callback)

    @property
    def configured(self) -> bool:
        """Return whether its state is another than unconfigured."""
        return bool(self._state_machine.current_state[0] != State.PRIMARY_STATE_UNCONFIGURED)

    def make_channel(self, publish_topic: str, subscribe_topic: str) -> TickChannel:
        """Make the node's end of the exchange; the cleanup closes it.

        Raises:
            ExchangeError: if another process on this machine publishes `publish_topic`.
        """
        self._channel = channel = self._make_channel(self, publish_topic, subscribe_topic, TICK_QOS)
        return channel

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, all or none; one that there is not is refused with those that there are."""
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                return SetParametersResult(
                    successful=False, reason=unknown_parameter(self, parameter.name)
                )
        return super().set_parameters_atomically(parameter_list)

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; all or nothing."""
        self._before = {kind: set(getattr(self, kind)) for kind in _ENTITIES}
        done = self._try("configure", self._configure)
        if done is not TransitionCallbackReturn.SUCCESS:
            self._clean_up()
        return done

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Activate."""
        return self._try("activate", self._managed.activate)

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._try("deactivate", self._managed.deactivate)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to unconfigured."""
        return self._try("clean up", self._clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process, with exit code 0."""
        if state.state_id == State.PRIMARY_STATE_ACTIVE:
            self._try("deactivate", self._managed.deactivate)
        self.ticking.stop()  # what else there is to do at the end is not for a callback: `stop` follows
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        self._managed.configure()
        if not self.starting:
            self.parameters.refuse_unknown()
        self.changes.publish_values()

    def _clean_up(self) -> None:
        self._managed.cleanup()
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        self.changes.forbid_all()
        for kind, kept in self._before.items():
            for entity in set(getattr(self, kind)) - kept:
                getattr(self, _ENTITIES[kind])(entity)

    def _try(self, what: str, transition: Callable[[], None]) -> TransitionCallbackReturn:
        self.error = None
        try:
            transition()
        except Exception as error:  # the service answers whatever happens
            self.error = error
            if not self.starting:
                text = (
                    str(error)
                    if isinstance(error, Rx90Error)
                    else f"{type(error).__name__}: {reason(error)}"
                )
                self.get_logger().error(one_line(f"cannot {what}: {text}"))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _change_state(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        known = {each[0]: each[1] for each in self._state_machine.available_transitions}
        requested = request.transition
        # rclpy raises for one that is not possible now, and nobody would be answered.
        if requested.label in known.values() or (not requested.label and requested.id in known):
            return change(request, response)
        name = plain(requested.label) if requested.label else f"transition {requested.id}"
        state = self._state_machine.current_state[1]
        accepted = ", ".join(known.values())
        self.get_logger().error(f"{name} is not possible in state {state}; accepted: {accepted}")
        response.success = False
        return response


def started(members: Iterable[_Member]) -> list[_Member]:
    """Configure all nodes that start by themselves, in this order, then activate them; return all."""
    members = list(members)
    own = [member.node for member in members if member.node.get_parameter("autostart").value]
    for node in own:
        node.starting = True
        _insist(node, node.trigger_configure())
    for member in members:
        if member.node.configured:
            member.node.parameters.refuse_unknown()
    for node in own:
        _insist(node, node.trigger_activate())
        node.starting = False
    return members


def _insist(node: ManagedNode, done: TransitionCallbackReturn) -> None:
    if done is not TransitionCallbackReturn.SUCCESS:
        raise node.error or RuntimeError(f"{node.get_name()}: {done}")


class TickThread:
    """The ticking thread of a managed node: it runs the configured node, until the cleanup."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._run: Callable[[], None] | None = None
        self._end: Callable[[], None] = lambda: None
        self._busy = self._stopped = False

    def loop(self) -> None:
        """Run the configured nodes, one after another; return after `stop`, or when a run has ended by itself."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or self._run is not None)
                run = self._run
                if self._stopped or run is None:
                    return
                self._busy = True
            try:
                run()
            finally:
                with self._changed:
                    self._busy = False
                    by_itself = self._run is run
                    self._changed.notify_all()
            if by_itself:
                return

    def begin(self, run: Callable[[], None], end: Callable[[], None]) -> None:
        """Have `run` run; `end`, callable from every thread, makes it return soon."""
        with self._changed:
            self._run = run
            self._end = end
            self._changed.notify_all()

    def finish(self) -> None:
        """End the run, and wait until it has ended."""
        with self._changed:
            end = self._end
            self._run = None
            self._end = lambda: None
        end()
        with self._changed:
            self._changed.wait_for(lambda: not self._busy)

    def stop(self) -> None:
        """End `loop` soon."""
        with self._changed:
            self._stopped = True
            end = self._end
            self._changed.notify_all()
        end()
