"""The simulation's time mode: it counts from the process whose motor states are answered, and from no other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from rx90_common.base.errors import MessageError
from rx90_common.base.quoting import counted, listed, one_line, quoted
from rx90_common.exchange.endpoints import ManualCallbackGroup, never_called
from rx90_common.exchange.pacing import error_log
from rx90_common.exchange.senders import NAMES_SENDERS, senders_on, take_with_sender
from rx90_common.exchange.topics import MOTOR_STATES, TIME_MODE, TimeMode

_LOOK = 0.1  # s between two looks at the topic
_PATIENCE = 2.0  # s in which the graph may still hear of the sender's motor states
_HEARD = 1.5  # s in which a simulation sends, also one whose time stands still
_MOST = 16  # other processes whose newest messages are kept, because they may be simulations later
# The middleware keeps the newest of all publishers: with a depth of 1, a stranger's would replace the simulation's.
_QOS = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
_STATES_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class SimulationMode:
    """Hands on each time mode that the simulation announces; those of others are one warning.

    The simulation is the process that alone sends motor states when a mode waits, for as long as the graph knows it to
    publish them. A publisher that sends nothing makes none.

    Args:
        node: the controller's.
        follow: called on the executor's thread.
    """

    def __init__(self, node: Node, follow: Callable[[TimeMode], None]) -> None:
        self._node = node
        self._follow = follow
        self._complaints = error_log(node)
        self._subscription = self._subscribe(String, TIME_MODE, _QOS)
        self._waiting: dict[
            bytes, tuple[float, bytes]
        ] = {}  # by process: until when, and its newest message
        self._simulation = b""  # its process
        self._states: Subscription | None = None  # only while the simulation is looked for
        self._senders: set[bytes] = set()  # of states, since then
        self._heard_from = 0.0
        self._warned = False
        self._warned_of_two = False
        node.create_timer(_LOOK, self._look)

    def _subscribe(self, kind: type, topic: str, qos: QoSProfile) -> Subscription:
        group = ManualCallbackGroup()
        return self._node.create_subscription(
            kind, topic, never_called, qos, raw=True, callback_group=group
        )

    def _look(self) -> None:
        now = time.monotonic()
        for raw, sender in take_with_sender(self._subscription):
            self._waiting.pop(sender, None)
            self._waiting[sender] = (now + _PATIENCE, raw)
        while len(self._waiting) > _MOST:
            del self._waiting[next(iter(self._waiting))]
        if not self._waiting:
            return
        publishing = senders_on(self._node, MOTOR_STATES)
        if (
            self._simulation not in publishing
            and get_rmw_implementation_identifier() in NAMES_SENDERS
        ):
            self._simulation = self._sender_of_states(now, publishing)
        if self._simulation in self._waiting:
            self._read(self._waiting.pop(self._simulation)[1])
        for sender, (deadline, raw) in self._waiting.items():
            if now > deadline and (self._simulation or sender not in publishing):
                self._warn(raw)

    def _sender_of_states(self, now: float, publishing: Mapping[bytes, str]) -> bytes:
        """Return the process that alone sends motor states, empty as long as there is none."""
        if self._states is None:
            self._states = self._subscribe(JointState, MOTOR_STATES, _STATES_QOS)
            self._senders.clear()
            self._heard_from = now
        self._senders.update(sender for _, sender in take_with_sender(self._states))
        self._senders &= publishing.keys()
        if not self._senders or (len(publishing) > 1 and now - self._heard_from < _HEARD):
            return b""
        if len(self._senders) > 1:
            self._warn_of_two(publishing)
            self._senders.clear()
            self._heard_from = now
            return b""
        self._node.destroy_subscription(self._states)
        self._states = None
        return self._senders.pop()

    def _warn_of_two(self, publishing: Mapping[bytes, str]) -> None:
        if not self._warned_of_two:
            self._warned_of_two = True
            names = listed(sorted(publishing[sender] for sender in self._senders))
            topic = self._subscription.topic_name
            states = self._node.resolve_topic_name(MOTOR_STATES)
            why = f"{topic}: {states} come from {names}; accepted: from one process; no mode is followed until then"
            self._node.get_logger().warning(one_line(why))

    def _read(self, raw: bytes) -> None:
        try:
            mode = TimeMode.parse(deserialize_message(raw, String).data)
        except MessageError as error:
            self._complaints.say("mode", f"{error}; ignored")
        except RuntimeError:  # the middleware's text names a place in its source
            topic = self._subscription.topic_name
            self._complaints.say(
                "mode",
                f"{topic}: {counted(len(raw), 'byte')}, no std_msgs/String; the message is ignored",
            )
        else:
            self._follow(mode)

    def _warn(self, raw: bytes) -> None:
        if not self._warned:
            self._warned = True
            text = quoted(raw[8:].decode("utf-8", "replace").rstrip("\0"))
            states = self._node.resolve_topic_name(MOTOR_STATES)
            why = f"of a process whose {states} are not followed; accepted: that of the simulation; others are ignored"
            middleware = get_rmw_implementation_identifier()
            if middleware not in NAMES_SENDERS:
                why = f"of a process that {middleware} does not name, ignored: the simulation counts as in lock-step; "
                why += f"accepted: {', '.join(NAMES_SENDERS)}"
            self._node.get_logger().warning(
                one_line(f"{self._subscription.topic_name}: {text} {why}")
            )
