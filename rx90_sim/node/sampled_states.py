"""joint_states and friction_states for those who look on, and need not hear of each of them."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from rx90_common.base.rates import Rates
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import CLOCK_QOS
from rx90_common.exchange.topics import SAMPLED, SAMPLED_RATE
from rx90_sim.plant import Plant


class SampledStates:
    """The same messages at SAMPLED_RATE, so that a page or a plot costs the tick a tenth; for the ticking thread.

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

    def publish_due(self, tick: int) -> None:
        """Publish the states of this tick if they are due, to those who listen."""
        if tick % self._ticks == 0:
            stamp = tick * self._period_ns
            self._plant.friction_states()
            # Also for nobody: who comes when time stands still gets the newest.
            self._samples = (self._encode_joints(stamp), self._encode_friction(stamp))
            self.repeat()

    def repeat(self) -> None:
        """Publish the newest samples again."""
        for publisher, sample in zip(self.publishers, self._samples, strict=False):
            if publisher.get_subscription_count():
                publisher.publish(sample)
