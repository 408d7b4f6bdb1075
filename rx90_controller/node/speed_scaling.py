"""The topic ~/speed_scaling_input; to be imported where control_msgs is."""

from __future__ import annotations

from control_msgs.msg import SpeedScalingFactor
from rclpy.node import Node

from rx90_common.base.errors import TrajectoryError
from rx90_common.exchange.qos import LATCHED_QOS
from rx90_common.exchange.subscribing import subscribe
from rx90_common.exchange.throttle import ThrottledLog
from rx90_controller.node.servo_loop import ServoLoop


class SpeedScaling:
    """Follows trajectories at the share of their speed that is asked for, also while one runs."""

    def __init__(self, node: Node, loop: ServoLoop) -> None:
        self._loop, self._log = loop, node.get_logger()
        self._said: float | None = None
        # Some repeat theirs hundreds of times a second, right or wrong.
        self._complaints = ThrottledLog(lambda text: node.get_logger().error(text))
        # As the original has it: who asked before this node was there is heard, too.
        subscribe(node, SpeedScalingFactor, "~/speed_scaling_input", self._on_factor, LATCHED_QOS.profile)

    def _on_factor(self, message: SpeedScalingFactor) -> None:
        try:
            with self._loop.between_ticks() as goals:
                goals.scale(message.factor)
        except TrajectoryError as error:
            self._complaints.say("factor", f"{error}; ignored")
        else:
            if message.factor != self._said:
                self._log.info(f"speed scaling {message.factor:g}")
                self._said = message.factor
