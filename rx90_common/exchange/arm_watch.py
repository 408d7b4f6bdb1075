"""Observe a running arm by its public topics, without making it wait."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import LATCHED_QOS, ManualCallbackGroup, never_called
from rx90_common.exchange.ros_start import controller_topic
from rx90_common.exchange.topics import SAMPLED, TIME_MODE, TRAJECTORY_ACCEPTED, TimeMode

_NODES = 20  # that may all speak at once
_SAMPLES = 100  # in a second


class _Newest:
    """A subscription that keeps the newest messages; dropped ones cost no processor time but the middleware's.

    Best effort, unless `latched`: the publisher neither waits for it nor repeats messages that it has missed.
    """

    def __init__(
        self, node: Node, kind: Any, topic: str, depth: int = 1, *, latched: bool = False
    ) -> None:
        newest = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        profile = LATCHED_QOS if latched else newest
        self._kind = kind
        self._depth = depth
        self._raw = kind is JointState
        self.subscription = node.create_subscription(
            kind, topic, never_called, profile, raw=self._raw, callback_group=ManualCallbackGroup()
        )
        self.topic = str(self.subscription.topic_name)

    def take(self) -> list[Any]:
        """Return the messages received since the last call, as far as they were kept, the newest last."""
        messages = (
            self.subscription.handle.take_message(self._kind, self._raw) for _ in range(self._depth)
        )
        return [one[0] for one in takewhile(lambda one: one is not None, messages)]


class JointSample(NamedTuple):
    """A message of type JointState: simulated time in s, and arrays in the order of the requested names."""

    time: float
    position: Array
    velocity: Array
    effort: Array


class NodeStatus(NamedTuple):
    """A node's diagnostics, once a second: 0 good, 1 warning, 2 error, 3 stale."""

    level: int
    message: str
    values: dict[str, str]


class Trajectory(NamedTuple):
    """A trajectory that was accepted.

    Attributes:
        begin: when it begins, simulated s.
        times: of its points, simulated s, shape (n,).
        position: of its points, rad, shape (n, joints).
        at_rest: the points at which the joints stand still, shape (n,).
    """

    begin: float
    times: Array
    position: Array
    at_rest: Mask

    @property
    def end(self) -> float:
        """Return when it ends, simulated s."""
        return float(self.times[-1])


class ArmWatch:
    """The newest messages of a simulation and a controller; some may be missed.

    Args:
        node: the subscriber.
        controller: name of the controller node, relative or absolute; the arm is in its namespace.
        joints: names of the joints.

    Attributes:
        problem: why the newest message of the arm does not belong to this robot; empty if it does.
        namespace: of the nodes, such as /cell; empty for none.
        robot: name of the simulation's robot; None until it is known.
        trajectory: the newest accepted one, as of the last call of `joints`; None if there is none.
        diagnostics: of the nodes in this namespace, by their names without it.
    """

    def __init__(self, node: Node, controller: str, joints: Sequence[str]) -> None:
        full = controller_topic(node, controller).rsplit("/", 1)[0]
        self.namespace = full.rsplit("/", 1)[0]
        self._codec = JointStateCodec(joints)
        self._node = node
        self._joints = self._listen(self.namespace)
        self._mode = _Newest(node, String, f"{self.namespace}/{TIME_MODE}", latched=True)
        self._accepted = _Newest(
            node, JointTrajectory, f"{full}/{TRAJECTORY_ACCEPTED}", latched=True
        )
        self._diagnostics = _Newest(node, DiagnosticArray, "/diagnostics", _NODES)
        self.problem = ""
        self.robot: str | None = None
        self.trajectory: Trajectory | None = None
        self.diagnostics: dict[str, NodeStatus] = {}

    def _listen(self, space: str) -> _Newest:
        return _Newest(self._node, JointState, f"{space}/joint_states", _SAMPLES)

    @property
    def topic(self) -> str:
        """Return the name of the arm's topic."""
        return self._joints.topic

    @property
    def publishers(self) -> int:
        """Return how many publishers of the arm's joint states there are."""
        return int(self._joints.subscription.get_publisher_count())

    def joints(self) -> list[JointSample]:
        """Return the samples of the joints received since the last call, as far as they were kept."""
        received = self._joints.take()
        for accepted in self._accepted.take():
            self.trajectory = _trajectory(accepted, self._codec.names)
        samples = []
        for raw in received:
            try:
                stamp, position, velocity, effort = self._codec.decode(raw)
                if position is None or velocity is None or effort is None:
                    raise ExchangeError(
                        "position, velocity or effort is empty; accepted: all three"
                    )
            except ExchangeError as error:
                self.problem = f"{self.topic}: {error}"
                return []
            samples.append(
                JointSample(stamp / NANOSECONDS, position.copy(), velocity.copy(), effort.copy())
            )
        if samples:
            self.problem = ""
        return samples

    def look_around(self) -> None:
        """Bring robot and diagnostics up to date; a few times a second is enough."""
        # The topics for viewers, where there are any: the others cost the simulation a tenth.
        sampled = f"{self.namespace}/{SAMPLED}"
        space = (
            sampled if self._node.count_publishers(f"{sampled}/joint_states") else self.namespace
        )
        if self.topic != f"{space}/joint_states":
            self._node.destroy_subscription(self._joints.subscription)
            self._joints = self._listen(space)
        for status in (status for message in self._diagnostics.take() for status in message.status):
            of, _, name = f"/{status.name}".rpartition("/")
            if of == self.namespace:
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                values = {pair.key: pair.value for pair in status.values}
                self.diagnostics[name] = NodeStatus(level, status.message, values)
        for mode in self._mode.take():
            try:
                self.robot = TimeMode.parse(mode.data).robot
            except MessageError as error:
                self.problem = str(error)


def _trajectory(message: JointTrajectory, joints: Sequence[str]) -> Trajectory | None:
    if not message.points or set(message.joint_names) != set(joints):
        return None
    order = [message.joint_names.index(joint) for joint in joints]
    begin = message_time_ns(message.header.stamp) / NANOSECONDS
    times = [
        begin + message_time_ns(point.time_from_start) / NANOSECONDS for point in message.points
    ]
    position = np.array([point.positions for point in message.points])[:, order]
    at_rest = np.array(
        [len(point.velocities) > 0 and not any(point.velocities) for point in message.points]
    )
    at_rest[-1] = True
    return Trajectory(begin, np.array(times), position, at_rest)
