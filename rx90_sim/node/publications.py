"""Publications of the simulation other than the motor states, due by tick and stamped with simulated time.

All functions are called by the ticking thread. A topic without subscribers is not published: a message takes longer
than the plant's step.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import ticks_per
from rx90_common.description.kinematics import LinkTransforms
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.cdr import JointStateCodec, transform_encoder
from rx90_common.exchange.endpoints import CLOCK_QOS, LATCHED_QOS, STATE_QOS, ros_time
from rx90_common.exchange.topics import SAMPLED, SAMPLED_RATE
from rx90_common.process.requirements import missing_module
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import Plant

# s of wall time between two samples, however fast time runs: in real time some come a little early
_SHORTEST_SAMPLED_PERIOD = 0.5 / SAMPLED_RATE


@dataclass(eq=False)
class PeriodicMessage:
    """A message that is published every few ticks, to those who listen.

    Attributes:
        publisher: of the topic.
        ticks: from one message to the next.
        encode: returns the message for a time, ns.
        least_gap: of wall time between two messages, s; one that comes earlier is left out.
        is_costly: whether it is not made while nobody listens; who comes then gets the next one.
    """

    publisher: Publisher
    ticks: int
    encode: Callable[[int], Any]
    least_gap: float = 0.0
    is_costly: bool = False
    _due: float = field(default=0.0, init=False)  # s of the steady clock
    _newest: Any = field(default=None, init=False)

    def publish_due(self, tick: int, stamp: int) -> None:
        """Publish the message of this tick, whose time is `stamp`, ns, if it is due."""
        if tick % self.ticks:
            return
        if self.is_costly and not self.publisher.get_subscription_count():
            self._newest = None
            return
        # Also without subscribers: one that subscribes while time stands still gets the newest.
        self._newest = self.encode(stamp)
        if self.least_gap:
            now = time.monotonic()
            if now < self._due:
                return
            self._due = now + self.least_gap
        self.repeat()

    def repeat(self) -> None:
        """Publish the newest message again, if there is one."""
        if self._newest is not None and self.publisher.get_subscription_count():
            self.publisher.publish(self._newest)


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
        joints = JointStateCodec(plant.joint_names).encoder(*plant.joint_states())
        encode_friction = JointStateCodec(plant.friction.names).encoder(*plant.friction_states())

        def friction(stamp: int) -> bytes:
            plant.friction_states()
            return encode_friction(stamp)

        ticks = ticks_per("joint_state_rate", rates.base_hz, parameters.joint_state_rate)
        sampled_ticks = max(1, rates.base_hz // SAMPLED_RATE)
        self._messages = []
        for name, encode in (("joint_states", joints), ("friction_states", friction)):
            publisher = node.create_publisher(JointState, name, STATE_QOS)
            is_costly = encode is friction
            self._messages.append(PeriodicMessage(publisher, ticks, encode, is_costly=is_costly))
            sampled = node.create_publisher(JointState, f"{SAMPLED}/{name}", CLOCK_QOS)
            self._messages.append(
                PeriodicMessage(sampled, sampled_ticks, encode, _SHORTEST_SAMPLED_PERIOD)
            )
        if parameters.tf_rate:
            self._messages.append(self._transforms(node, robot, parameters))
        self._messages.append(
            PeriodicMessage(
                node.create_publisher(Clock, "/clock", CLOCK_QOS),
                ticks_per("clock_rate", rates.base_hz, parameters.clock_rate),
                lambda stamp: Clock(clock=ros_time(stamp)),
            )
        )
        self.publishers = tuple(message.publisher for message in self._messages)

    def _transforms(
        self, node: Node, robot: RobotModel, parameters: SimulationParameters
    ) -> PeriodicMessage:
        """Publish the fixed frames of the URDF on /tf_static; return the joints' on /tf.

        They are for where no robot_state_publisher is.
        """
        ticks = ticks_per("tf_rate", parameters.rates.base_hz, parameters.tf_rate)
        try:
            # only on request: the pip environment may be without
            from tf2_msgs.msg import TFMessage
        except ImportError as error:
            missing = missing_module(error) or error
            raise ConfigError(
                f"parameter tf_rate is {parameters.tf_rate}: {missing}; or 0"
            ) from error
        moving = LinkTransforms(robot, fixed=False)
        fixed = LinkTransforms(robot, fixed=True)
        still = fixed.rotation(np.zeros(len(robot.joint_names)))
        self._static = node.create_publisher(TFMessage, "/tf_static", LATCHED_QOS)
        self._static.publish(transform_encoder(fixed.links, fixed.translation)(0, still))
        position = self._plant.joint_states()[0]
        encode = transform_encoder(moving.links, moving.translation)
        return PeriodicMessage(
            node.create_publisher(TFMessage, "/tf", STATE_QOS),
            ticks,
            lambda stamp: encode(stamp, moving.rotation(position)),
        )

    def publish_due(self) -> None:
        """Publish the messages that are due in the plant's current tick."""
        tick = self._plant.tick
        for message in self._messages:
            message.publish_due(tick, tick * self._period_ns)

    def repeat(self) -> None:
        """Publish the newest messages again; in tick 0, before it has run, those that it will publish."""
        if self._plant.tick == 0:
            self.publish_due()
        else:
            for message in self._messages:
                message.repeat()
