"""Joint commands as motor torques, and reasons why a controller's commands do not arrive, each reported once."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.endpoints import TICK_QOS
from rx90_common.exchange.pacing import OnceLog
from rx90_common.exchange.topics import COMMAND_INTERFACES
from rx90_sim.joint_interface import JointInterface

_JOINT_STATE = "sensor_msgs/msg/JointState"
_LOOK = 1.0  # s between two looks at the graph
_CROWDED_LOOKS = 25  # at two controllers in a row: a user's process that was killed stays in the graph for 20 s


class JointCommands:
    """Reads efforts at the joints, by name in any order.

    Args:
        joints: the drives seen from the joints.
        names: of the joints.
        topic: of the commands, for messages.
        once: reports, once, that there are no efforts.
    """

    def __init__(self, joints: JointInterface, names: tuple[str, ...], topic: str, once: OnceLog) -> None:
        self._joints, self._codec, self._topic, self._once = joints, JointStateCodec(names), topic, once
        self._accepted = f"{len(names)} efforts at the joints, Nm"

    def decode(self, raw: bytes) -> Array | None:
        """Return the motor torques, motor side, Nm, shape (n,), valid until the next call; None for brakes closed.

        Raises:
            ExchangeError: if the message is not a command for these joints.
        """
        _, position, velocity, effort = self._codec.decode(raw)
        if effort is not None:
            return self._joints.motor_torques(effort)
        if position is not None or velocity is not None:
            given = " and ".join(n for n, v in (("position", position), ("velocity", velocity)) if v is not None)
            raise ExchangeError(f"{given} without effort; accepted: {self._accepted}")
        self._once.say(f"{self._topic}: effort is empty: no torque, brakes closed; for torque: {self._accepted}")
        return None


class CommandWatch:
    """Checks the graph once a second, on the executor's thread.

    Args:
        node: of the simulation.
        interface: the commanded one, of COMMAND_INTERFACES.
        once: reports each problem once.
    """

    def __init__(self, node: Node, interface: str, once: OnceLog) -> None:
        self._node, self._once, self._interface = node, once, interface
        self._states, self._commands = (str(node.resolve_topic_name(one)) for one in COMMAND_INTERFACES[interface])
        self._others = {
            other: str(node.resolve_topic_name(commands))
            for other, (_, commands) in COMMAND_INTERFACES.items()
            if other != interface
        }
        self._crowded = 0
        self._known: set[tuple[int, ...]] = set()  # endpoints of the last look
        self._found: set[tuple[int, ...]] = set()  # those of this one
        self._timer = node.create_timer(_LOOK, self.look)

    def look(self) -> None:
        """Report problems of the publishers of commands, and of the subscribers of the states that commands answer."""
        self._known, self._found = self._found, set()
        found = self._named(self._node.get_publishers_info_by_topic(self._commands))
        for info in found:
            if info.topic_type != _JOINT_STATE:
                self._say(info, f"publishes {info.topic_type}; accepted: {_JOINT_STATE}")
            elif info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                self._say(info, "publishes best effort, which is not heard; accepted: reliable, such as QoS depth 1")
        self._crowded = self._crowded + 1 if len(found) > 1 else 0
        if self._crowded == _CROWDED_LOOKS:
            names = ", ".join(sorted(info.node_name for info in found))
            self._once.say(f"{self._commands}: {len(found)} publishers, {names}; accepted: one controller")
        for info in self._named(self._node.get_subscriptions_info_by_topic(self._states)):
            requested = QoSProfile(
                depth=1, reliability=info.qos_profile.reliability, durability=info.qos_profile.durability
            )
            compatible, reason = qos_check_compatible(TICK_QOS, requested)
            if compatible == QoSCompatibility.ERROR:
                self._once.say(
                    f"{self._states}: node {info.node_name} does not get the states ({reason.strip(' ;')}); accepted: "
                    "volatile, reliable or best effort"
                )
        for other, topic in self._others.items():
            for info in self._named(self._node.get_publishers_info_by_topic(topic)):
                self._once.say(
                    f"{topic}: node {info.node_name} is not heard, because command_interface is {self._interface}; "
                    f"accepted: commands on {self._commands}, or -p command_interface:={other}"
                )

    def _named(self, endpoints: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        """Return those that were there a look ago: of a new one the graph may not know the node's name yet."""
        gids = [tuple(info.endpoint_gid) for info in endpoints]
        self._found.update(gids)
        return [info for info, gid in zip(endpoints, gids, strict=True) if gid in self._known]

    def _say(self, info: TopicEndpointInfo, text: str) -> None:
        self._once.say(f"{self._commands}: node {info.node_name} {text}")
