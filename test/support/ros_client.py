"""What a test asks of the running nodes: services, trajectories, the newest message of a topic."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Duration
from processes import TIMEOUT
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

JOINTS = [f"joint_{i}" for i in range(1, 7)]


class Client:
    """A node that calls services and keeps what it hears."""

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("test_client", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publisher = self.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 10)

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self, topic: str, kind: type = JointState, depth: int = 1000) -> list[Any]:
        """Return a list that grows with the messages of a topic; with a depth of 1, those there is time for."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, depth)
        return heard

    def spin_until(self, condition: Callable[[], bool], what: str, timeout: float = TIMEOUT) -> None:
        """Listen until a condition holds; fail the test when it does not."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s in vain for {what}")
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, service: str, *, data: bool | None = None) -> Any:
        """Call a Trigger, or with `data` a SetBool, and return the answer."""
        kind, request = (Trigger, Trigger.Request()) if data is None else (SetBool, SetBool.Request(data=data))
        caller = self.node.create_client(kind, service)
        self.spin_until(caller.service_is_ready, f"service {service}")
        answer = caller.call_async(request)
        self.spin_until(answer.done, f"an answer of {service}")
        return answer.result()

    def send(self, points: Sequence[tuple[float, Sequence[float]]], names: Sequence[str] = tuple(JOINTS)) -> None:
        """Send a trajectory that starts now: times in s and positions in rad, at rest in the last point."""
        message = JointTrajectory(joint_names=list(names))
        for seconds, position in points:
            whole = int(seconds)
            message.points.append(
                JointTrajectoryPoint(
                    positions=list(position),
                    velocities=[0.0] * len(position),
                    time_from_start=Duration(sec=whole, nanosec=round((seconds - whole) * 1e9)),
                )
            )
        self.spin_until(lambda: self._publisher.get_subscription_count() > 0, "the controller's subscription")
        self._publisher.publish(message)


def seconds(message: JointState) -> float:
    """Return a message's header.stamp in s."""
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
