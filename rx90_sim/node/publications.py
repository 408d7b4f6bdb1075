"""What the simulation publishes beside the motor states, due by tick and stamped with simulated time."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from rx90_common.base.rates import NANOSECONDS, ticks_per
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.qos import CLOCK_QOS, STATE_QOS
from rx90_common.exchange.qos_overrides import publish
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.node.sampled_states import SampledStates
from rx90_sim.node.temperatures import Temperatures
from rx90_sim.node.transforms import Transforms
from rx90_sim.plant import Plant


class Publications:
    """The states, temperatures, /clock and, where there are any, the transforms; called by the ticking thread."""

    def __init__(
        self, node: Node, plant: Plant, parameters: SimulationParameters, transforms: Transforms | None
    ) -> None:
        """Make the publishers.

        Raises:
            ConfigError: if a rate does not divide the base rate.
        """
        rates = parameters.rates
        self._plant, self._transforms = plant, transforms
        self._period_ns = rates.period_ns
        self._state_ticks = ticks_per("joint_state_rate", rates.base_hz, parameters.joint_state_rate)
        self._clock_ticks = ticks_per("clock_rate", rates.base_hz, parameters.clock_rate)
        self._encode_joints = JointStateCodec(plant.joint_names).encoder(*plant.joint_states())
        self._encode_friction = JointStateCodec(plant.friction_names).encoder(*plant.friction_states())
        self._joints = publish(node, JointState, "joint_states", STATE_QOS.profile)
        self._friction = publish(node, JointState, "friction_states", STATE_QOS.profile)
        self._joint_sample = self._friction_sample = b""  # the newest, as it was sent; empty: not sent
        self._sampled = SampledStates(node, plant, rates)
        self._temperatures = Temperatures(node, plant, rates)
        self._time = Clock()
        self._clock = publish(node, Clock, "/clock", CLOCK_QOS.profile)

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Return the publishers."""
        own = (self._joints, self._friction, self._temperatures.publisher, self._clock, *self._sampled.publishers)
        return own if self._transforms is None else (*own, self._transforms.publisher)

    def publish_due(self) -> None:
        """Publish what is due in the plant's current tick."""
        tick = self._plant.tick
        stamp = tick * self._period_ns
        if tick % self._state_ticks == 0:
            self._joint_sample = self._encode_joints(stamp)
            self._friction_sample = b""
            # What nobody listens to is not sent: a message costs the tick more than the plant's step.
            if self._joints.get_subscription_count():
                self._joints.publish(self._joint_sample)
            if self._friction.get_subscription_count():
                self._plant.friction_states()
                self._friction_sample = self._encode_friction(stamp)
                self._friction.publish(self._friction_sample)
        self._sampled.publish_due(tick)
        self._temperatures.publish_due(tick)
        if self._transforms is not None:
            self._transforms.publish_due(tick, stamp)
        if tick % self._clock_ticks == 0:
            self._time.clock.sec, self._time.clock.nanosec = divmod(stamp, NANOSECONDS)
            self._clock.publish(self._time)

    def repeat(self) -> None:
        """Publish the newest samples again; in tick 0, before it has run, those that it will publish."""
        if self._plant.tick == 0:
            self.publish_due()
            return
        if self._joints.get_subscription_count():
            self._joints.publish(self._joint_sample)
        # Who came when nobody listened gets no friction states: those of an earlier tick cannot be made up for.
        if self._friction_sample and self._friction.get_subscription_count():
            self._friction.publish(self._friction_sample)
        self._sampled.repeat()
        if self._transforms is not None:
            self._transforms.repeat()
        self._clock.publish(self._time)
