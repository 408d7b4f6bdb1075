"""Publications of the simulation other than the motor states, due by tick and stamped with simulated time.

All functions are called by the ticking thread. A topic without subscribers is not published: a message takes longer
than the plant's step.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates, ticks_per
from rx90_common.description.kinematics import link_transforms
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.cdr import JointStateCodec, TransformCodec
from rx90_common.exchange.endpoints import CLOCK_QOS, LATCHED_QOS, STATE_QOS, ros_time
from rx90_common.exchange.topics import MAX_DISPLAY_RTF, SAMPLED, SAMPLED_RATE
from rx90_common.process.requirements import missing_module
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import Plant

_SAMPLED_PERIOD = 1.0 / SAMPLED_RATE
# s of wall time from one sample to the next in a run faster than MAX_DISPLAY_RTF
_DISPLAY_PERIOD = 1.0 / 30.0


class SampledStates:
    """The same messages at SAMPLED_RATE, so that a page or a plot needs a tenth of the time per tick.

    That is a rate of simulated time. If a simulation runs faster than real time, 30 are sent in a second of wall time:
    more cannot be seen, and each of them delays the next tick.

    Args:
        node: owner of the topics.
        plant: whose states they are.
        rates: of the simulation.
        encode: return the message of joints and that of friction for a time, ns.

    Attributes:
        publishers: of both topics.
    """

    def __init__(
        self, node: Node, plant: Plant, rates: Rates, encode: tuple[Callable[[int], bytes], ...]
    ) -> None:
        self._plant = plant
        self._period_ns = rates.period_ns
        self._ticks = max(1, rates.base_hz // SAMPLED_RATE)
        self._encode = encode
        self.publishers: tuple[Publisher, Publisher] = (
            node.create_publisher(JointState, f"{SAMPLED}/joint_states", CLOCK_QOS),
            node.create_publisher(JointState, f"{SAMPLED}/friction_states", CLOCK_QOS),
        )
        self._samples: tuple[bytes, ...] = ()
        # s of the steady clock: when the next is due, and when the last one was
        self._due = self._published = 0.0
        self._since = 0  # samples since the last one that was published

    def publish_due(self, tick: int) -> None:
        """Publish the states of this tick if they are due, to those who listen."""
        if tick % self._ticks == 0:
            stamp = tick * self._period_ns
            self._plant.friction_states()
            # Also without subscribers: one that subscribes while time stands still gets the newest.
            self._samples = tuple(encode(stamp) for encode in self._encode)
            self._since += 1
            now = time.monotonic()
            # in real time some ticks come a little early
            if now >= self._due - 0.5 * _SAMPLED_PERIOD:
                fast = self._since > 1 and self._since * _SAMPLED_PERIOD > MAX_DISPLAY_RTF * (
                    now - self._published
                )
                self._due = max(self._due, now) + (_DISPLAY_PERIOD if fast else _SAMPLED_PERIOD)
                self._published = now
                self._since = 0
                self.repeat()

    def repeat(self) -> None:
        """Publish the newest samples again."""
        for publisher, sample in zip(self.publishers, self._samples, strict=False):
            if publisher.get_subscription_count():
                publisher.publish(sample)


class Transforms:
    """The frames of the URDF, for where no robot_state_publisher is: fixed ones on /tf_static, the joints' on /tf.

    Args:
        node: owner of the topics.
        robot: with its tool.
        plant: whose joints turn the frames.
        parameters: with the rate of /tf, which is not 0.

    Attributes:
        publisher: of /tf.
    """

    def __init__(
        self, node: Node, robot: RobotModel, plant: Plant, parameters: SimulationParameters
    ) -> None:
        self._ticks = ticks_per("tf_rate", parameters.rates.base_hz, parameters.tf_rate)
        try:
            # only on request: the pip environment may be without
            from tf2_msgs.msg import TFMessage
        except ImportError as error:
            missing = missing_module(error) or error
            raise ConfigError(
                f"parameter tf_rate is {parameters.tf_rate}: {missing}; or 0"
            ) from error
        self._moving, fixed = link_transforms(robot)
        self._position = plant.joint_states()[0]
        self._codec = TransformCodec(self._moving.links, self._moving.translation)
        self._sample = b""  # the newest
        self.publisher: Publisher = node.create_publisher(TFMessage, "/tf", STATE_QOS)
        self._static = node.create_publisher(TFMessage, "/tf_static", LATCHED_QOS)
        still = fixed.rotation(np.zeros(len(fixed.links)))
        self._static.publish(TransformCodec(fixed.links, fixed.translation).encode(0, still))

    def publish_due(self, tick: int, stamp: int) -> None:
        """Publish the transforms if they are due in this tick, whose time is `stamp`, ns."""
        if tick % self._ticks == 0:
            self._sample = self._codec.encode(stamp, self._moving.rotation(self._position))
            self.repeat()

    def repeat(self) -> None:
        """Publish the newest transforms, if somebody listens."""
        if self._sample and self.publisher.get_subscription_count():
            self.publisher.publish(self._sample)


class Publications:
    """The states, /clock and, where `tf_rate` is not 0, the transforms.

    Args:
        node: owner of the topics.
        robot: with its tool.
        plant: whose states they are.
        parameters: with the rates.

    Attributes:
        publishers: of all topics but /tf_static.
    """

    def __init__(
        self, node: Node, robot: RobotModel, plant: Plant, parameters: SimulationParameters
    ) -> None:
        rates = parameters.rates
        self._plant = plant
        self._period_ns = rates.period_ns
        self._transforms = (
            Transforms(node, robot, plant, parameters) if parameters.tf_rate else None
        )
        self._state_ticks = ticks_per(
            "joint_state_rate", rates.base_hz, parameters.joint_state_rate
        )
        self._clock_ticks = ticks_per("clock_rate", rates.base_hz, parameters.clock_rate)
        self._encode_joints = JointStateCodec(plant.joint_names).encoder(*plant.joint_states())
        self._encode_friction = JointStateCodec(plant.friction.names).encoder(
            *plant.friction_states()
        )
        self._joints = node.create_publisher(JointState, "joint_states", STATE_QOS)
        self._friction = node.create_publisher(JointState, "friction_states", STATE_QOS)
        # the newest, as it was sent; empty: not sent
        self._joint_sample = self._friction_sample = b""
        encode = (self._encode_joints, self._encode_friction)
        self._sampled = SampledStates(node, plant, rates, encode)
        self._time = Clock()
        self._clock = node.create_publisher(Clock, "/clock", CLOCK_QOS)
        own = (self._joints, self._friction, self._clock, *self._sampled.publishers)
        self.publishers = own if self._transforms is None else (*own, self._transforms.publisher)

    def publish_due(self) -> None:
        """Publish the messages that are due in the plant's current tick."""
        tick = self._plant.tick
        stamp = tick * self._period_ns
        if tick % self._state_ticks == 0:
            self._joint_sample = self._encode_joints(stamp)
            self._friction_sample = b""
            if self._joints.get_subscription_count():
                self._joints.publish(self._joint_sample)
            if self._friction.get_subscription_count():
                self._plant.friction_states()
                self._friction_sample = self._encode_friction(stamp)
                self._friction.publish(self._friction_sample)
        self._sampled.publish_due(tick)
        if self._transforms is not None:
            self._transforms.publish_due(tick, stamp)
        if tick % self._clock_ticks == 0:
            self._time.clock = ros_time(stamp)
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
