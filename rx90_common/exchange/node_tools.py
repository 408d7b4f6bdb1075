"""What both nodes share: parameters with descriptors, diagnostics, the frame around their two threads."""

from __future__ import annotations

import gc
import re
import sys
import threading
import traceback
from array import array
from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import Any, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.duration import Duration, Infinite
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import Executor, ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.utilities import try_shutdown
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import DEFAULT_ROBOT, DESCRIPTIONS, RobotFiles
from rx90_common.exchange.parameter_changes import OF_ROS, with_real_numbers
from rx90_common.exchange.qos import CLOCK_QOS
from rx90_common.exchange.qos_overrides import PREFIX, overridable_topics, publish
from rx90_common.exchange.ros_start import reason, start_ros
from rx90_common.exchange.throttle import ThrottledLog
from rx90_common.process.interrupts import stop_request

_SPIN_SLICE = 0.2
_SETTLED_LOOKS = 10  # of 50 ms
_RECEIVED_LOOKS = 40  # of 50 ms
_SWITCH_INTERVAL = 5e-4
_Value = TypeVar("_Value", bool, int, float, str, list[float])
_TYPES = {kind.value for kind in Parameter.Type}


_TYPE_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


def declare(
    node: Node,
    name: str,
    default: _Value,
    description: str,
    *,
    low: float | None = None,
    high: float | None = None,
    read_only: bool | None = None,
) -> _Value:
    """Declare a parameter with its descriptor, unless it is declared, and return its value.

    Args:
        node: its owner.
        name: of the parameter.
        default: its value where none is given.
        description: what it means, with its unit.
        low: the least that is accepted.
        high: the most.
        read_only: whether it can never be set; None: only those of a managed node can, as ParameterChanges says.

    Raises:
        ConfigError: naming parameter, value and accepted range.
    """
    if node.has_parameter(name):
        return _plain(node.get_parameter(name).value)  # type: ignore[no-any-return]
    if read_only is None:
        read_only = not isinstance(node, LifecycleNode)
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if low is not None and high is not None:
        if isinstance(default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        else:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    override = node._parameter_overrides.get(name)  # rclpy names neither value nor range in a way to show
    given = getattr(override, "value", None)
    accepted = "list of numbers" if isinstance(default, list) else type(default).__name__
    if low is not None:
        accepted += f" in [{low:g}, {high:g}]"
    if override is not None:
        if given is None:
            raise ConfigError(f"parameter {name} is empty; accepted: {accepted}")
        node._parameter_overrides[name] = with_real_numbers(override, default)
    try:
        value: Any = node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise ConfigError(f"parameter {name} is {quoted(given)}; accepted: {accepted}") from error
    return _plain(value)  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    """Return a value as plain Python has it: rclpy gives lists as arrays where they were set."""
    return value.tolist() if isinstance(value, array) else value


def declare_rates(node: Node) -> Rates:
    """Declare the rates, which both nodes must have alike, and return them.

    Raises:
        ConfigError: for a rate that is out of range, or that does not divide.
    """
    usual = Rates()
    about = "rate of plant, velocity and current loops, and of the exchange, Hz"
    base = declare(node, "base_rate", usual.base_hz, about, low=100, high=20000)
    about = "rate of the position loop and of set-points, Hz"
    return Rates(base, declare(node, "position_rate", usual.position_hz, about, low=10, high=20000))


def declare_robot_files(node: Node, *names: str) -> RobotFiles:
    """Declare `robot` and a parameter for each of these keys of FILES; return the files that they name.

    Raises:
        ConfigError: for a robot or a file that is not there.
    """
    about = "robot: name of a shipped one, or your own robot folder"
    robot = declare(node, "robot", DEFAULT_ROBOT, about)
    of_robot = RobotFiles.named(robot)
    given: dict[str, str | None] = {}
    for name in names:
        override = node._parameter_overrides.get(name)
        if override is not None and override.value == "":  # what a launch argument left out comes to
            del node._parameter_overrides[name]
        usual = of_robot.text(name)
        chosen = declare(node, name, usual, f"{DESCRIPTIONS[name]}; the robot's or your own")
        given[name] = None if chosen == usual else chosen
    return RobotFiles.named(robot, **given)


def refuse_unknown_parameters(nodes: Sequence[Node]) -> None:
    """Look for values given to parameters that a node has not declared; to be called when all are declared.

    A managed node that is not configured has not declared all of them.

    Raises:
        ConfigError: naming the first one, and those that there are, or the node of this process that has it.
    """
    for node in nodes:
        for name in node._parameter_overrides:
            if not node.has_parameter(name) and name not in OF_ROS:
                owners = [other.get_name() for other in nodes if other.has_parameter(name)]
                accepted = f"-p {owners[0]}:{name}:=... for that node alone" if owners else declared_instead(node, name)
                raise ConfigError(f"parameter {plain(name)} is unknown to {node.get_name()}; accepted: {accepted}")


def declared_instead(node: Node, name: str) -> str:
    """Return the parameters that the node has instead of `name`."""
    if name.startswith(PREFIX):
        return overridable_topics(node)
    return ", ".join(sorted(known for known in node._parameters if known not in OF_ROS and PREFIX not in known))


class Diagnostics:
    """One status on /diagnostics, once a second.

    Args:
        node: the publisher's node.
        collect: returns the level (OK, WARN or ERROR of DiagnosticStatus), the message and the values.
    """

    def __init__(self, node: Node, collect: Callable[[], tuple[bytes, str, dict[str, str]]]) -> None:
        self._node = node
        self._collect = collect
        self._publisher = publish(node, DiagnosticArray, "/diagnostics", CLOCK_QOS.profile)
        # Without the leading slash, as diagnostic_aggregator writes names.
        self._namespace = node.get_namespace().strip("/")
        self._timer = node.create_timer(1.0, self._publish)

    def _publish(self) -> None:
        level, message, values = self._collect()
        status = DiagnosticStatus(
            level=level,
            name=self._with_namespace(self._node.get_name()),
            message=message,
            hardware_id=self._with_namespace("rx90_emulator"),
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def _with_namespace(self, name: str) -> str:
        return f"{self._namespace}/{name}" if self._namespace else name


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
    for node in nodes:
        answer_all_requests(node)
    failures: list[BaseException] = []
    threads = [
        threading.Thread(target=_guard, args=(member.tick_loop, failures), name="ticks", daemon=True)
        for member in members
    ]
    executor = make_executor() if make_executor is not None else _executor_of(len(members))
    for node in nodes:
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
            thread.join(5.0)
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


def _executor_of(nodes: int) -> Executor:
    return SingleThreadedExecutor() if nodes == 1 else MultiThreadedExecutor(nodes)


def _guard(run: Callable[[], None], failures: list[BaseException]) -> None:
    try:
        run()
    except BaseException as error:
        failures.append(error)


def wait_until_matched(
    node: Node, publishers: Sequence[Publisher], attempts: int, stop: Callable[[], bool] = lambda: False
) -> bool:
    """Wait until every subscription that the graph knows of is matched with our publishers.

    A recorder that was started before then gets the first message too. The graph learns of its members one by one, so
    it must also have stayed as it is for half a second. Who asks for another quality of service than is offered is
    never matched, and not waited for.

    Args:
        node: the publishers' node.
        publishers: of all topics.
        attempts: how often to look, 50 ms apart.
        stop: tells that there is something else to do.
    """
    pause = threading.Event()
    before: list[int] = []
    quiet = 0
    for _ in range(attempts):
        if stop():
            return False
        known = [fitting_subscriptions(node, publisher) for publisher in publishers]
        have = [publisher.get_subscription_count() for publisher in publishers]
        complete = all(h >= k for h, k in zip(have, known, strict=True))
        quiet = quiet + 1 if complete and have == before else 0
        if quiet >= _SETTLED_LOOKS:
            return True
        before = have
        pause.wait(0.05)
    return False


def wait_until_received(publishers: Sequence[Publisher]) -> None:
    """Let the last messages reach who listens, a recorder for example; not without end, who listens may be stopped."""
    for publisher in publishers:
        for _ in range(_RECEIVED_LOOKS):
            if publisher.wait_for_all_acked(Duration(nanoseconds=50_000_000)):
                break


def fitting_subscriptions(node: Node, publisher: Publisher) -> int:
    """Return how many subscriptions the graph knows of that a publisher's quality of service suits."""
    asked = [_asked(info.qos_profile) for info in node.get_subscriptions_info_by_topic(publisher.topic_name)]
    offered = publisher.qos_profile
    return sum(qos_check_compatible(offered, profile)[0] != QoSCompatibility.ERROR for profile in asked)


def _asked(profile: QoSProfile) -> QoSProfile:
    """Return what is asked for: where no times are, the graph reports infinite ones, which the check would compare."""
    times = {name: getattr(profile, name) for name in ("deadline", "liveliness_lease_duration")}
    return QoSProfile(
        depth=1,
        reliability=profile.reliability,
        durability=profile.durability,
        **{name: time for name, time in times.items() if time < Infinite},
    )


def answer_all_requests(node: Node) -> None:
    """Let the services refuse what rclpy cannot take.

    It does not survive a value of a type that does not exist. A type hash that is none is printed as it is by rcl, with
    its line breaks.
    """
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _one_by_one(service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _all_or_none(service.callback)
        elif service.srv_type is GetTypeDescription:
            service.callback = _of_a_type(service.callback)


def _one_by_one(set_parameters: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            refused = _refusal(parameter)
            if refused is None:
                set_parameters(SetParameters.Request(parameters=[parameter]), response)
            else:
                response.results.append(refused)
        return response

    return answer


def _all_or_none(set_parameters: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            refused = _refusal(parameter)
            if refused is not None:
                response.result = refused
                return response
        return set_parameters(request, response)

    return answer


def _of_a_type(describe: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        if _TYPE_HASH.fullmatch(request.type_hash):
            return describe(request, response)
        response.successful = False
        response.failure_reason = f"type_hash is {quoted(request.type_hash)}; accepted: RIHS01_ and 64 digits"
        return response

    return answer


def _refusal(parameter: Any) -> SetParametersResult | None:
    kind = parameter.value.type
    if kind in _TYPES:
        return None
    reason = f"parameter {quoted(parameter.name)} has a value of type {kind}; accepted: {min(_TYPES)} to {max(_TYPES)}"
    return SetParametersResult(successful=False, reason=reason)
