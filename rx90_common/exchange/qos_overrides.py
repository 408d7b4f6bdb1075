"""Quality of service given as parameters, `qos_overrides./joint_states.publisher.depth` and so on, as rclcpp has them.

Depth, reliability and durability can be chosen. History cannot: a publisher that keeps all stops the tick, for as long
as the lease of a reader that was killed.
"""

from __future__ import annotations

from typing import Any, Final

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted

PREFIX: Final = "qos_overrides."
_MOST = 100_000  # messages
_DEPTH = range(1, _MOST + 1)
_ACCEPTED = {
    QoSPolicyKind.DEPTH: (_DEPTH, f"a whole number in [1, {_MOST}]"),
    QoSPolicyKind.RELIABILITY: (("reliable", "best_effort"), "reliable, best_effort"),
    QoSPolicyKind.DURABILITY: (("volatile", "transient_local"), "volatile, transient_local"),
}


def publish(node: Node, kind: Any, topic: str, qos: QoSProfile) -> Publisher:
    """Make a publisher whose quality of service the node's parameters may change.

    Raises:
        ConfigError: naming parameter, value and what is accepted.
    """
    return node.create_publisher(kind, topic, qos, qos_overriding_options=overridable(node, topic, "publisher"))


def overridable(node: Node, topic: str, entity: str) -> QoSOverridingOptions:
    """Return the options with which rclpy declares and applies the parameters of a topic.

    Args:
        node: owner of the parameters.
        topic: relative or absolute name.
        entity: "publisher" or "subscription".

    Raises:
        ConfigError: naming parameter, value and what is accepted.
    """
    for policy, (values, accepted) in _ACCEPTED.items():
        name = f"{PREFIX}{node.resolve_topic_name(topic)}.{entity}.{policy.name.lower()}"
        given = node._parameter_overrides.get(name)  # rclpy's own errors name no parameter
        if given is not None and (isinstance(given.value, bool) or given.value not in values):
            raise ConfigError(f"parameter {plain(name)} is {quoted(given.value)}; accepted: {accepted}")
    return QoSOverridingOptions(list(_ACCEPTED))


def overridable_topics(node: Node) -> str:
    """Return, for a message, what can be chosen, once the node has all its topics; of the others it is fixed."""
    known = {known.removeprefix(PREFIX).rpartition(".")[0] for known in node._parameters if known.startswith(PREFIX)}
    return f"{', '.join(policy.name.lower() for policy in _ACCEPTED)} of {', '.join(sorted(known))}"
