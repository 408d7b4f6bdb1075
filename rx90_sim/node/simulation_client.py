"""Other programs at a simulation node: a client of its services and time, and a controller that answers its states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.client_node import ClientNode, spoken
from rx90_common.exchange.topics import JOINT_COMMANDS, MEASURED_JOINT_STATES

_PAUSE = "rx90_sim/pause"


class SimulationClient:
    """Time of a simulation node.

    Attributes:
        time: newest simulated time, s, updated by `ClientNode.spin`.
    """

    def __init__(self, client: ClientNode) -> None:
        self._client = client
        self.time = 0.0
        client.node.create_subscription(Clock, "/clock", self._on_clock, 10)

    def _on_clock(self, message: Clock) -> None:
        self.time = message_time_ns(message.clock) / NANOSECONDS

    def pause(self, paused: bool) -> None:
        """Stop time, or let it run.

        Raises:
            ExchangeError: if the node does not do it.
        """
        request = SetBool.Request(data=paused)
        spoken(_PAUSE)(self._client.call(SetBool, _PAUSE, request))


_DEPTH = 10


class EffortController:
    """Answers each message on `measured_joint_states` with one on `joint_commands` that bears the same stamp.

    Plain rclpy, as a controller for a real arm would be written.

    Args:
        node: owner of publisher and subscription.
        controller: takes measured joint positions rad, velocities rad/s, both of shape (n,), and time s; returns
            efforts at the joints, Nm, shape (n,), or None for no torque and closed brakes.
        names: of the joints, in the order in which the controller has them.

    Attributes:
        time: of the newest states, s; None before the first.
    """

    def __init__(
        self,
        node: Node,
        controller: Callable[[Array, Array, float], ArrayLike | None],
        names: tuple[str, ...],
    ):
        self._controller = controller
        self._names = names
        self.time: float | None = None
        self._commands = node.create_publisher(JointState, JOINT_COMMANDS, _DEPTH)
        self._states = node.create_subscription(
            JointState, MEASURED_JOINT_STATES, self._answer, _DEPTH
        )

    def _answer(self, states: Any) -> None:
        received = states.name
        if sorted(received) != sorted(self._names):
            raise ExchangeError(
                f"{self._states.topic_name} has {', '.join(received)}; accepted: {', '.join(self._names)}"
            )
        order = [received.index(name) for name in self._names]
        stamp = states.header.stamp
        self.time = stamp.sec + stamp.nanosec * 1e-9
        position = np.array(states.position)[order]
        velocity = np.array(states.velocity)[order]
        effort = self._controller(position, velocity, self.time)
        command = JointState(name=self._names)
        command.header.stamp = stamp
        if effort is not None:
            command.effort = np.asarray(effort, dtype=np.float64).tolist()
        self._commands.publish(command)
