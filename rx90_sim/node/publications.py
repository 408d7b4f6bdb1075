"""What the simulation publishes beside the motor states, due by tick and stamped with simulated time."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from rx90_common.base.rates import NANOSECONDS, Rates, ticks_per
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.topics import CLOCK_QOS, STATE_QOS
from rx90_sim.plant import Plant


class Publications:
    """joint_states, friction_states and /clock; called by the ticking thread."""

    def __init__(self, node: Node, plant: Plant, rates: Rates, state_hz: int, clock_hz: int) -> None:
        """Make the publishers.

        Raises:
            ConfigError: if a rate does not divide the base rate.
        """
        self._plant = plant
        self._period_ns = rates.period_ns
        self._state_ticks = ticks_per("joint_state_rate", rates.base_hz, state_hz)
        self._clock_ticks = ticks_per("clock_rate", rates.base_hz, clock_hz)
        self._encode_joints = JointStateCodec(plant.joint_names).encoder(*plant.joint_states())
        self._encode_friction = JointStateCodec(plant.friction_names).encoder(*plant.friction_states())
        self._joints = node.create_publisher(JointState, "joint_states", STATE_QOS.profile)
        self._friction = node.create_publisher(JointState, "friction_states", STATE_QOS.profile)
        self._clock = node.create_publisher(Clock, "/clock", CLOCK_QOS.profile)

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Return the publishers."""
        return self._joints, self._friction, self._clock

    def publish_due(self) -> None:
        """Publish what is due in the plant's current tick."""
        tick = self._plant.tick
        stamp = tick * self._period_ns
        if tick % self._state_ticks == 0:
            # What nobody listens to is not sent: a message costs the tick more than the plant's step.
            if self._joints.get_subscription_count():
                self._joints.publish(self._encode_joints(stamp))
            if self._friction.get_subscription_count():
                self._plant.friction_states()
                self._friction.publish(self._encode_friction(stamp))
        if tick % self._clock_ticks == 0:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(stamp, NANOSECONDS)
            self._clock.publish(message)
