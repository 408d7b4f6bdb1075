"""The topic ~/controller_state, sent by the ticking thread; to be imported where control_msgs is."""

from __future__ import annotations

from control_msgs.msg import JointTrajectoryControllerState
from rclpy.node import Node

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.qos import STATE_QOS
from rx90_common.exchange.qos_overrides import publish
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.state_message import StateMessage


class ControllerState:
    """Set-points, measured joints, their difference and the commanded torques, a few times a second.

    Attributes:
        publisher: to look at what it is matched with.
        period_ns: from one message to the next.
    """

    def __init__(self, node: Node, cs7b: CS7B, state_ticks: int) -> None:
        """Publish every `state_ticks` position ticks."""
        self._cs7b = cs7b
        self._message = StateMessage(cs7b.joint_names)
        self.publisher = publish(node, JointTrajectoryControllerState, "~/controller_state", STATE_QOS.profile)
        self.period_ns = cs7b.rates.period_ns * cs7b.rates.ratio * state_ticks

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left, if somebody listens."""
        if not self.publisher.get_subscription_count():
            return
        cs7b, message, numbers = self._cs7b, self._message, self._message.numbers
        tick = cs7b.position_tick - 1
        progress = cs7b.trajectory.progress(tick)
        since = round(min(max(progress.time, 0.0), progress.last) * NANOSECONDS)
        message.stamp[:] = divmod(stamp_ns, NANOSECONDS)
        for time in message.times:
            time[:] = divmod(since, NANOSECONDS)
        fields = ("positions", "velocities", "accelerations")
        measured = cs7b.measured()
        for row, field in enumerate(fields):
            numbers["reference", field][:] = cs7b.setpoint[row]
        for row, field in enumerate(fields[:2]):
            numbers["feedback", field][:] = measured[row]
            numbers["error", field][:] = cs7b.setpoint[row] - measured[row]
        numbers["output", "effort"][:] = cs7b.tracking_error()[2]
        message.scaling[0] = cs7b.trajectory.speed_scaling(tick)
        self.publisher.publish(message.encode())
