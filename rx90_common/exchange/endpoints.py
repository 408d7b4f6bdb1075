"""Publishers and subscriptions of nodes: quality of service, unreadable messages, waits for subscribers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
)
from rclpy.serialization import deserialize_message

from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.pacing import error_log

_LOOK = 0.05  # s between two looks at the graph
_SETTLED_LOOKS = 10
_UNMATCHED_LOOKS = 40
_SLICE = Duration(nanoseconds=50_000_000)
_DELIVERY_TIMEOUT = 4.0  # s; shorter than the wait for the end of a ticking thread
_SHARE = 0.75  # of the publishers' history that is sent before the next wait
_PATIENCE = 6.0  # s; the lease of a process that was killed, in config/dds, is 5 s


# All are reliable, as rclpy has it by default.
# Deep enough that a recorder which does not run for a second loses nothing. KEEP_ALL would stop the tick instead, for
# as long as the lease of a recorder that was killed.
TICK_QOS = QoSProfile(depth=8000)
STATE_QOS = QoSProfile(depth=2000)
CLOCK_QOS = QoSProfile(depth=10)
# Also for subscribers that come later.
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# A burst is answered one by one, each with a line of its own; planning takes longer than sending.
TRAJECTORY_QOS = QoSProfile(depth=1000)
# ROS keeps 10 requests that wait for their turn, and drops the next ones without a word.
REQUEST_QOS = QoSProfile(depth=2000)


def ros_time(nanoseconds: int) -> Time:
    """Return a time, ns, as a message; `rx90_common.exchange.cdr` reads them."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def subscribe(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[[Any], object],
    qos: QoSProfile,
) -> None:
    """Call `callback` with each message of type `kind`, on the executor's thread; report an unreadable one in a line.

    The serialised bytes are received, because the middleware's own messages name no topic and run over several lines.

    Args:
        node: the subscriber.
        kind: class of the messages.
        topic: relative or absolute name.
        callback: called with a message.
        qos: of the subscription.
    """

    def take(raw: bytes) -> None:
        try:
            message = deserialize_message(raw, kind)
        except RuntimeError:  # the middleware's text names a place in its source
            wrong = (
                f"{counted(len(raw), 'byte')}, no {kind.__module__.split('.')[0]}/{kind.__name__}"
            )
            log.say("bytes", f"{subscription.topic_name}: {wrong}; the message is ignored")
            return
        callback(message)

    log = error_log(node)
    subscription = node.create_subscription(kind, topic, take, qos, raw=True)


class ManualCallbackGroup(CallbackGroup):
    """Keeps the node's executor away from a subscription whose messages somebody takes from it."""

    def can_execute(self, entity: object) -> bool:  # noqa: ARG002 - the interface of CallbackGroup
        """Say no to each message."""
        return False

    def beginning_execution(self, entity: object) -> bool:  # noqa: ARG002 - the interface of CallbackGroup
        """Say no again, if it were asked."""
        return False

    def ending_execution(self, entity: object) -> None:
        """Do nothing: none begins."""


def never_called(_message: object) -> None:
    """Stand for the callback of such a subscription."""


def wait_until_matched(
    node: Node,
    publishers: Sequence[Publisher],
    attempts: int,
    stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Wait until every subscription in the graph is matched with our publishers; return whether that has settled.

    A recorder that was started before then gets the first message too. The graph discovers its members one by one, so
    it must also have been constant for half a second; or for two seconds, if subscriptions are not matched, as those
    with an incompatible quality of service never are.

    Args:
        node: the publishers' node.
        publishers: of all topics.
        attempts: number of checks, 50 ms apart.
        stop: returns whether to stop waiting.
    """
    pause = threading.Event()
    before: list[tuple[int, int]] = []
    quiet = 0
    for _ in range(attempts):
        if stop():
            break
        counts = [
            (node.count_subscribers(publisher.topic_name), publisher.get_subscription_count())
            for publisher in publishers
        ]
        quiet = quiet + 1 if counts == before else 0
        is_complete = all(matched >= known for known, matched in counts)
        if quiet >= (_SETTLED_LOOKS if is_complete else _UNMATCHED_LOOKS):
            return True
        before = counts
        pause.wait(_LOOK)
    return False


def wait_until_received(publishers: Sequence[Publisher]) -> None:
    """Let the last messages reach their subscribers, a recorder for example; at most 4 s for all topics together."""
    deadline = time.monotonic() + _DELIVERY_TIMEOUT
    for publisher in publishers:
        while not publisher.wait_for_all_acked(_SLICE) and time.monotonic() < deadline:
            pass


class Listeners:
    """Keeps an unpaced run from outrunning its subscribers; owned by the ticking thread.

    Publishers keep two seconds of simulated time. An unpaced run computes them in a fraction of that time, and a
    recorder that the machine delays for so long would lose messages. So every few thousand ticks the run waits until
    its messages have arrived.

    Args:
        publishers: of the messages that must arrive.
        state_ticks: ticks from one message to the next, for topics that are not published in each.
        interrupted: called 20 times a second during a wait; ends it if it returns True.
        clock: the steady clock, s.

    Attributes:
        others: returns publishers that another thread may destroy, whose messages are waited for, too.
    """

    def __init__(
        self,
        publishers: Sequence[Publisher],
        state_ticks: int,
        interrupted: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._interrupted = interrupted
        self._clock = clock
        self._watched: list[tuple[Publisher, int]] = []
        self.others: Callable[[], Sequence[Publisher]] = tuple
        self.add(publishers)
        self._ticks = self._left = int(_SHARE * min(TICK_QOS.depth, STATE_QOS.depth * state_ticks))

    def add(self, publishers: Sequence[Publisher], answering: int = 0) -> None:
        """Wait for the messages of these, too, if there are more subscriptions than the `answering` ones."""
        self._watched += [(publisher, answering) for publisher in publishers]

    def tick_done(self) -> None:
        """Count a tick; wait if it is time to."""
        self._left -= 1
        if self._left == 0:
            self._left = self._ticks
            deadline = self._clock() + _PATIENCE
            for publisher, answering in (*self._watched, *((other, 0) for other in self.others())):
                with suppress(InvalidHandle):  # destroyed: nothing to wait for
                    while publisher.get_subscription_count() > answering:
                        if (
                            publisher.wait_for_all_acked(_SLICE)
                            or self._interrupted()
                            or self._clock() > deadline
                        ):
                            break
