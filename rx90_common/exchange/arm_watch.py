"""Watch a running arm by its public topics, without making it wait."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, ExchangeError, MessageError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.joint_state_parser import parse_joint_state
from rx90_common.exchange.newest import Newest
from rx90_common.exchange.ros_start import reason
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import TIME_MODE, TRAJECTORY_ACCEPTED

_NODES = 20  # that may all speak at once
_SERVICE = "joint_trajectory"  # any name below the controller's


class JointSample(NamedTuple):
    """A message of type JointState: simulated time in s, and arrays in the order of the names asked for."""

    time: float
    position: Array
    velocity: Array
    effort: Array


class NodeStatus(NamedTuple):
    """What a node says of itself once a second: 0 good, 1 warning, 2 error, 3 stale."""

    level: int
    message: str
    values: dict[str, str]


class Span(NamedTuple):
    """When a trajectory begins and ends, simulated s."""

    begin: float
    end: float


class ArmWatch:
    """The newest of what a simulation and a controller publish; whoever asks may miss some.

    Args:
        node: that listens.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.
        joints: names of the joints.
        elements: names of the friction elements.

    Attributes:
        problem: why the newest message of the arm is not one of this robot; empty if it is.
        robot: name of the simulation's robot; None until it is known.
        trajectory: the one that was accepted last; None if there is none.
        diagnostics: what the nodes of this namespace say, by their names without it.

    Raises:
        ConfigError: if that cannot be a node's name.
    """

    def __init__(self, node: Node, controller: str, joints: Sequence[str], elements: Sequence[str]) -> None:
        try:
            full = str(node.resolve_topic_name(f"{controller or '/'}/{_SERVICE}")).rsplit("/", 1)[0]
        except RuntimeError as error:
            raise ConfigError(
                f"the controller node's name is {quoted(controller)} ({reason(error)}); "
                "accepted: a name such as rx90_controller or /cell/rx90_controller"
            ) from error
        self._namespace = full.rsplit("/", 1)[0]
        self._names = tuple(joints), tuple(elements)
        self._joints = Newest(node, JointState, f"{self._namespace}/joint_states", raw=True)
        self._elements = Newest(node, JointState, f"{self._namespace}/friction_states", raw=True)
        self._mode = Newest(node, String, f"{self._namespace}/{TIME_MODE}", latched=True)
        self._accepted = Newest(node, JointTrajectory, f"{full}/{TRAJECTORY_ACCEPTED}", latched=True)
        self._diagnostics = Newest(node, DiagnosticArray, "/diagnostics", depth=_NODES)
        self.problem = ""
        self.robot: str | None = None
        self.trajectory: Span | None = None
        self.diagnostics: dict[str, NodeStatus] = {}

    @property
    def topic(self) -> str:
        """Return the name of the arm's topic."""
        return self._joints.topic

    @property
    def publishers(self) -> int:
        """Return how many publishers of the arm's joint states there are."""
        return self._joints.publishers

    def joints(self) -> JointSample | None:
        """Return the newest sample of the joints that came since the last call; None if none did."""
        return self._take(self._joints, self._names[0])

    def elements(self) -> JointSample | None:
        """Return likewise that of the friction elements: bristle deflection, velocity, friction torque."""
        return self._take(self._elements, self._names[1])

    def _take(self, topic: Newest, names: tuple[str, ...]) -> JointSample | None:
        raw = topic.take()
        if raw is None:
            return None
        try:
            stamp, arrays = parse_joint_state(raw, names)
            if any(array is None for array in arrays):
                raise ExchangeError("position, velocity or effort is empty; accepted: all three")
        except ExchangeError as error:
            self.problem = f"{topic.topic}: {error}"
            return None
        self.problem = ""
        return JointSample(stamp / NANOSECONDS, *arrays)  # type: ignore[arg-type]  # none is None

    def look_around(self) -> None:
        """Bring robot, trajectory and diagnostics up to date."""
        for message in self._diagnostics.take_all():
            for status in message.status:
                self._note(status)
        mode = self._mode.take()
        if mode is not None:
            try:
                self.robot = TimeMode.parse(mode.data).robot
            except MessageError as error:
                self.problem = str(error)
        accepted = self._accepted.take()
        if accepted is not None:
            self.trajectory = _span(accepted)

    def _note(self, status: Any) -> None:
        space, _, name = f"/{status.name}".rpartition("/")
        if space == self._namespace:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self.diagnostics[name] = NodeStatus(level, status.message, {pair.key: pair.value for pair in status.values})


def _span(message: JointTrajectory) -> Span | None:
    if not message.points:
        return None
    begin = message_time_ns(message.header.stamp) / NANOSECONDS
    return Span(begin, begin + message_time_ns(message.points[-1].time_from_start) / NANOSECONDS)
