"""Managed nodes, as design.ros2.org/articles/node_lifecycle.html has them: states, transitions, and who ticks when."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

from lifecycle_msgs.msg import State
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from rx90_common.base.errors import Rx90Error
from rx90_common.base.quoting import one_line, plain
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.channel import MakeChannel, TickChannel
from rx90_common.exchange.endpoints import TICK_QOS
from rx90_common.exchange.node_tools import TickingNode
from rx90_common.exchange.parameters import (
    ParameterChanges,
    declare,
    declare_robot_files,
    refuse_unknown_parameters,
    unknown_parameter,
)
from rx90_common.exchange.ros_start import reason

_ENTITIES = {  # what a configured node may have made, and what destroys it
    "publishers": "destroy_publisher",
    "subscriptions": "destroy_subscription",
    "clients": "destroy_client",
    "services": "destroy_service",
    "timers": "destroy_timer",
    "guards": "destroy_guard_condition",
}


def declare_autostart(node: Node) -> bool:
    """Declare and return whether a managed node is active at once."""
    about = "configure and activate the node when it starts; else that is left to its lifecycle services"
    return declare(node, "autostart", True, about, read_only=True)


class Managed(TickingNode, Protocol):
    """What a managed node is made of; the transitions are called on the executor's thread."""

    @property
    def node(self) -> ManagedNode:
        """The node, with the services."""

    def configure(self) -> None:
        """Load what the parameters say; raises Rx90Error. What it makes of the node is destroyed at the cleanup."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Rest."""

    def cleanup(self) -> None:
        """Let go of all that was loaded; also after a `configure` that was refused."""


_Member = TypeVar("_Member", bound=Managed)


class ManagedNode(LifecycleNode):
    """The services of a managed node, and what its states mean for its parameters and for what it is made of.

    Args:
        name: of the node.
        own_args: arguments for ROS that concern this node of its process alone.
        managed: what the transitions are handed to.
        make_channel: makes the node's end of the exchange.

    Attributes:
        changes: answers requests to set parameters.
        ticking: the thread that ticks, from a `configure` to the cleanup.
        autostart: whether it is configured and activated at the start, by `started`.
        starting: whether that is going on.
        error: why the last transition was refused, if it was.
    """

    def __init__(self, name: str, own_args: Sequence[str], managed: Managed, make_channel: MakeChannel) -> None:
        super().__init__(name, cli_args=list(own_args))
        self._managed, self._make_channel = managed, make_channel
        self._channel: TickChannel | None = None
        self.changes = ParameterChanges(self, lambda: not self.configured)
        self.ticking = TickThread()
        self.autostart = declare_autostart(self)
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
        self._channel = channel = self._make_channel(self, publish_topic, subscribe_topic, TICK_QOS.profile)
        return channel

    def declare_robot_files(self, *names: str) -> RobotFiles:
        """Declare what `parameters.declare_robot_files` does; with another robot come its files, but for named ones.

        Raises:
            ConfigError: for a robot or a file that is not there.
        """
        chosen = declare_robot_files(self, *names)
        self.changes.follow_robot(*names)
        return chosen

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, all or none; one that there is not is refused with those that there are."""
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                return SetParametersResult(successful=False, reason=unknown_parameter(self, parameter.name))
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
            refuse_unknown_parameters([self])
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
                text = str(error) if isinstance(error, Rx90Error) else f"{type(error).__name__}: {reason(error)}"
                self.get_logger().error(one_line(f"cannot {what}: {text}"))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _change_state(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        known = {each[0]: each[1] for each in self._state_machine.available_transitions}
        asked = request.transition
        # rclpy raises for one that is not possible now, and nobody would be answered.
        if asked.label in known.values() or (not asked.label and asked.id in known):
            return change(request, response)
        name = plain(asked.label) if asked.label else f"transition {asked.id}"
        state, accepted = self._state_machine.current_state[1], ", ".join(known.values())
        self.get_logger().error(f"{name} is not possible in state {state}; accepted: {accepted}")
        response.success = False
        return response


def started(members: Iterable[_Member]) -> list[_Member]:
    """Configure all nodes that start themselves, in this order, then activate them; return all.

    Raises:
        Rx90Error: what `configure` raises.
    """
    members = list(members)
    own = [member.node for member in members if member.node.autostart]
    for node in own:
        node.starting = True
        _insist(node, node.trigger_configure())
    refuse_unknown_parameters([member.node for member in members if member.node.configured])
    for node in own:
        _insist(node, node.trigger_activate())
        node.starting = False
    return members


def _insist(node: ManagedNode, done: TransitionCallbackReturn) -> None:
    if done is not TransitionCallbackReturn.SUCCESS:
        raise node.error or RuntimeError(f"{node.get_name()}: {done}")


class TickThread:
    """The ticking thread of a managed node: it runs what was configured, until the cleanup."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._run: Callable[[], None] | None = None
        self._end: Callable[[], None] = lambda: None
        self._busy = self._stopped = False

    def loop(self) -> None:
        """Run what there is to run, again and again; return after `stop`, or when a run has ended by itself."""
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
            self._run, self._end = run, end
            self._changed.notify_all()

    def finish(self) -> None:
        """End what runs, and wait until it has ended."""
        with self._changed:
            end, self._run, self._end = self._end, None, lambda: None
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
