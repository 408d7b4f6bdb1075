"""The simulation's time mode: it counts from the process whose motor states are answered, and from no other one."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import String

from rx90_common.base.errors import MessageError
from rx90_common.base.quoting import counted, one_line, quoted
from rx90_common.exchange.endpoints import ManualCallbackGroup, never_called
from rx90_common.exchange.pacing import error_log
from rx90_common.exchange.senders import NAMES_SENDERS, senders_on, take_with_sender
from rx90_common.exchange.topics import MOTOR_STATES, TIME_MODE, TimeMode

_LOOK = 0.1  # s between two looks at the topic
_PATIENCE = 2.0  # s in which the graph may still hear of the sender's motor states
_MOST = 16  # other processes whose newest messages are kept, because they may be simulations later
# The middleware keeps the newest of all publishers: with a depth of 1, a stranger's would replace the simulation's.
_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class SimulationMode:
    """Hands on each time mode that a publisher of the motor states announces; others are one warning.

    Args:
        node: the controller's.
        follow: called on the executor's thread.
    """

    def __init__(self, node: Node, follow: Callable[[TimeMode], None]) -> None:
        self._node = node
        self._follow = follow
        self._complaints = error_log(node)
        self._subscription = node.create_subscription(
            String, TIME_MODE, never_called, _QOS, raw=True, callback_group=ManualCallbackGroup()
        )
        self._waiting: dict[bytes, tuple[float, bytes]] = {}  # by process: until when, and its newest message
        self._warned = False
        node.create_timer(_LOOK, self._look)

    def _look(self) -> None:
        now = time.monotonic()
        for raw, sender in take_with_sender(self._subscription):
            self._waiting.pop(sender, None)
            self._waiting[sender] = (now + _PATIENCE, raw)
        while len(self._waiting) > _MOST:
            del self._waiting[next(iter(self._waiting))]
        if not self._waiting:
            return
        simulations = senders_on(self._node, MOTOR_STATES)
        for sender, (deadline, raw) in list(self._waiting.items()):
            if sender in simulations:
                del self._waiting[sender]
                self._read(raw)
            elif now > deadline:
                self._warn(raw)

    def _read(self, raw: bytes) -> None:
        try:
            mode = TimeMode.parse(deserialize_message(raw, String).data)
        except MessageError as error:
            self._complaints.say("mode", f"{error}; ignored")
        except RuntimeError:  # the middleware's text names a place in its source
            topic = self._subscription.topic_name
            self._complaints.say(
                "mode", f"{topic}: {counted(len(raw), 'byte')}, no std_msgs/String; the message is ignored"
            )
        else:
            self._follow(mode)

    def _warn(self, raw: bytes) -> None:
        if not self._warned:
            self._warned = True
            text = quoted(raw[8:].decode("utf-8", "replace").rstrip("\0"))
            states = self._node.resolve_topic_name(MOTOR_STATES)
            why = f"of a process that publishes no {states}; accepted: that of the simulation; all others are ignored"
            middleware = get_rmw_implementation_identifier()
            if middleware not in NAMES_SENDERS:
                why = f"of a process that {middleware} does not name, ignored: the simulation counts as in lock-step; "
                why += f"accepted: {', '.join(NAMES_SENDERS)}"
            self._node.get_logger().warning(one_line(f"{self._subscription.topic_name}: {text} {why}"))
