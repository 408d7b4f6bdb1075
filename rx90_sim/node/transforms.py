"""/tf and /tf_static from the simulation itself, for where no robot_state_publisher is."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher

from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import ticks_per
from rx90_common.base.requirements import missing_module
from rx90_common.description.link_transforms import LinkTransforms, link_transforms
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.qos import LATCHED_QOS, STATE_QOS
from rx90_common.exchange.transform_cdr import TransformCodec
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.plant import Plant


class Transforms:
    """The frames of the URDF: fixed ones latched on /tf_static, the joints' on /tf, stamped with simulated time.

    Args:
        node: owner of the topics.
        robot: with its tool.
        plant: whose joints turn the frames.
        ticks: from one message on /tf to the next.

    Attributes:
        publisher: of /tf.

    Raises:
        ImportError: where tf2_msgs is not there.
    """

    def __init__(self, node: Node, robot: RobotModel, plant: Plant, ticks: int) -> None:
        from tf2_msgs.msg import TFMessage  # only where it is asked for: the pip environment may be without

        moving, fixed = link_transforms(robot)
        self._position = plant.joint_states()[0]
        self._ticks, self._moving = ticks, moving
        self._codec = TransformCodec(moving.links, moving.translation)
        self._sample = b""  # the newest
        self.publisher: Publisher = node.create_publisher(TFMessage, "/tf", STATE_QOS.profile)
        self._static = node.create_publisher(TFMessage, "/tf_static", LATCHED_QOS.profile)
        self._static.publish(_still(fixed))

    @classmethod
    def of_parameters(
        cls, node: Node, robot: RobotModel, plant: Plant, parameters: SimulationParameters
    ) -> Transforms | None:
        """Return what publishes them at the parameter `tf_rate`; None for 0.

        Raises:
            ConfigError: if the rate does not divide the base rate, or tf2_msgs is not there.
        """
        rate = parameters.tf_rate
        if not rate:
            return None
        ticks = ticks_per("tf_rate", parameters.rates.base_hz, rate)
        try:
            return cls(node, robot, plant, ticks)
        except ImportError as error:
            raise ConfigError(f"parameter tf_rate is {rate}: {missing_module(error) or error}; or 0") from error

    def publish_due(self, tick: int, stamp: int) -> None:
        """Publish the transforms if they are due in this tick, whose time is `stamp`, ns."""
        if tick % self._ticks == 0:
            self._sample = self._codec.encode(stamp, self._moving.rotation(self._position))
            self.repeat()

    def repeat(self) -> None:
        """Publish the newest transforms, if somebody listens."""
        if self._sample and self.publisher.get_subscription_count():
            self.publisher.publish(self._sample)


def _still(fixed: LinkTransforms) -> bytes:
    return TransformCodec(fixed.links, fixed.translation).encode(0, fixed.rotation(np.zeros(len(fixed.links))))
