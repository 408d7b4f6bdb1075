"""Subscriptions of nodes: by callback, where a message that cannot be read is one line, or taken by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.qos_overrides import overridable
from rx90_common.exchange.throttle import ThrottledLog


def subscribe(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[[Any], None],
    qos: QoSProfile,
    check: Callable[[bytes], None] | None = None,
) -> None:
    """Call `callback` with each message of type `kind`, on the executor's thread.

    The bytes are taken as they are, because the middleware's own complaints name no topic and run over several lines.

    Args:
        node: the subscriber.
        kind: class of the messages.
        topic: relative or absolute name.
        callback: takes a message.
        qos: of the subscription.
        check: reads the bytes before the middleware does and raises ExchangeError for what is wrong with them. For
            types with sequences, whose lengths the middleware complains of on standard error by itself.
    """

    def take(raw: bytes) -> None:
        try:
            if check is not None:
                check(raw)
            message = deserialize_message(raw, kind)
        except ExchangeError as error:
            log.say("bytes", f"{subscription.topic_name}: {error}; the message is ignored")
        except RuntimeError:  # of the middleware, whose text names a place in its source
            text = f"{len(raw)} bytes are no {kind.__module__.split('.')[0]}/{kind.__name__}"
            log.say("bytes", f"{subscription.topic_name}: {text}; the message is ignored")
        else:
            callback(message)

    log = ThrottledLog(lambda text: node.get_logger().error(text))
    overrides = overridable(node, topic, "subscription")
    subscription = node.create_subscription(kind, topic, take, qos, raw=True, qos_overriding_options=overrides)


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
