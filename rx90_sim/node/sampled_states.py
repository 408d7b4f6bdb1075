"""joint_states and friction_states for those who look on, and need not hear of each of them."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from rx90_common.base.rates import Rates
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import CLOCK_QOS
from rx90_common.exchange.topics import HURRIES, SAMPLED, SAMPLED_RATE
from rx90_sim.plant import Plant

_PERIOD = 1.0 / SAMPLED_RATE
_SELDOM = 1.0 / 30.0  # s of wall time from one to the next, where time hurries


class SampledStates:
    """The same messages at SAMPLED_RATE, so that a page or a plot costs the tick a tenth; for the ticking thread.

    That is a rate of simulated time. Where a simulation runs faster than time there are 30 in a second of wall time:
    nobody sees more, and each of them keeps the simulation from its next tick.

    Args:
        node: owner of the topics.
        plant: whose states they are.
        rates: of the simulation.

    Attributes:
        publishers: of both topics.
    """

    def __init__(self, node: Node, plant: Plant, rates: Rates) -> None:
        self._plant, self._period_ns = plant, rates.period_ns
        self._ticks = max(1, rates.base_hz // SAMPLED_RATE)
        self._encode_joints = JointStateCodec(plant.joint_names).encoder(*plant.joint_states())
        self._encode_friction = JointStateCodec(plant.friction_names).encoder(*plant.friction_states())
        self.publishers: tuple[Publisher, Publisher] = (
            node.create_publisher(JointState, f"{SAMPLED}/joint_states", CLOCK_QOS.profile),
            node.create_publisher(JointState, f"{SAMPLED}/friction_states", CLOCK_QOS.profile),
        )
        self._samples: tuple[bytes, ...] = ()
        self._due = self._published = 0.0  # s of the steady clock: when the next is due, and when the last one was
        self._since = 0  # samples since the last one that was published

    def publish_due(self, tick: int) -> None:
        """Publish the states of this tick if they are due, to those who listen."""
        if tick % self._ticks == 0:
            stamp = tick * self._period_ns
            self._plant.friction_states()
            # Also for nobody: who comes when time stands still gets the newest.
            self._samples = (self._encode_joints(stamp), self._encode_friction(stamp))
            self._since += 1
            now = time.monotonic()
            if now >= self._due - 0.5 * _PERIOD:  # in real time some ticks come a little early
                hurries = self._since > 1 and self._since * _PERIOD > HURRIES * (now - self._published)
                self._due = max(self._due, now) + (_SELDOM if hurries else _PERIOD)
                self._published, self._since = now, 0
                self.repeat()

    def repeat(self) -> None:
        """Publish the newest samples again."""
        for publisher, sample in zip(self.publishers, self._samples, strict=False):
            if publisher.get_subscription_count():
                publisher.publish(sample)
