"""What a program needs of running nodes: set-points one by one, the measured position, signals on topics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import monotonic

from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Int32MultiArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.client_node import ClientNode
from rx90_common.exchange.endpoints import LATCHED_QOS, ros_time
from rx90_controller.node.trajectory_client import TrajectoryClient, enable_request

_SILENCE = 5.0  # s; diagnostics come once a second
OUTPUTS = "outputs"
INPUTS = "inputs"


class ProgramClient:
    """Sends set-points to a controller, on the simulated time of its arm.

    Args:
        client: the node to do it with, in whose private name the topics of signals are.
        controller: name of the controller node.
        names: of the joints.

    Attributes:
        start: measured joint angles in the beginning, rad, shape (n,).
        outage: why the arm has, or had, no torque, in the controller's words, until the power is switched; or empty.
    """

    def __init__(self, client: ClientNode, controller: str, names: Sequence[str]) -> None:
        self._client = client
        self._controller = controller
        self._names = list(names)
        trajectories = TrajectoryClient(client, controller)
        trajectories.wait_for_controller()
        self._targets = client.node.create_publisher(
            JointState, f"{controller}/joint_setpoints", 10
        )
        self._client.wait(
            lambda: self._targets.get_subscription_count() > 0, "a controller that takes set-points"
        )
        self._arm = trajectories.arm(names)
        self.start = self._arm.position
        self._began: float | None = None
        self._sent = 0.0
        self._seen = 0.0
        self._powered = True
        self._enabled: bool | None = None
        self.outage = ""
        self._heard = monotonic()
        client.node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, 20)
        patient = replace(client, timeout=max(client.timeout, _SILENCE))
        patient.wait(lambda: self._enabled is not None, "the controller's diagnostics")

    def position(self) -> Array:
        """Return the newest measured joint angles, rad, shape (n,)."""
        return self._arm.position

    def rest(self, _: float) -> Array:
        """Send nothing until the power is back, and return the newest measured joint angles, rad, shape (n,)."""
        self._powered = False
        return self.position()

    def power(self, on: bool) -> None:
        """Switch the torque on or off, and wait until the controller says so.

        Raises:
            ExchangeError: if it refuses, or does not answer.
        """
        self._powered = False
        self._enabled = None
        request = enable_request(self._controller, on)
        request.read(self._client.call(request.kind, request.service, request.request))
        self._client.wait(lambda: self._enabled == on, "the controller's word on its torque")
        self._powered = on
        self.outage = ""
        self._began = None  # the arm's time has gone on

    def _take_status(self, message: DiagnosticArray) -> None:
        name = self._client.node.resolve_service_name(self._controller).strip("/")
        for status in message.status:
            if status.name == name:
                self._heard = monotonic()
                self._enabled = KeyValue(key="enabled", value="true") in status.values
                if not self._enabled:
                    self.outage = f"{name}: {status.message}"

    def send(self, time: float, position: Array, velocity: Array) -> None:
        """Send a set-point for a simulated time from the first one on, s, and let the arm come to that time.

        Without power nothing is sent.

        Raises:
            ExchangeError: if its time stands still.
        """
        if self._began is None or self._arm.time < self._seen:
            before = self._arm.count
            self._client.wait(lambda: self._arm.count > before + 1, "the arm's time")
            self._began = self._arm.time - self._sent
        self._sent = time
        stamp = self._began + time
        if self._powered:
            message = JointState(
                name=self._names, position=position.tolist(), velocity=velocity.tolist()
            )
            message.header.stamp = ros_time(round(stamp * NANOSECONDS))
            self._targets.publish(message)
        latest = monotonic() + self._client.timeout
        while self._arm.time < stamp:
            self._client.spin()
            if monotonic() > latest:
                raise ExchangeError(
                    f"the arm's time stands still at {self._arm.time:.3f} s; accepted: while it runs"
                )
        self._seen = self._arm.time
        if monotonic() > self._heard + max(self._client.timeout, _SILENCE):
            self.outage = f"{self._controller} is silent"

    def signals(self, receive: Callable[[set[int]], None]) -> Callable[[set[int]], None]:
        """Return what publishes the outputs that are on; `receive` gets the inputs that are on."""
        publisher = self._client.node.create_publisher(Int32MultiArray, f"~/{OUTPUTS}", LATCHED_QOS)

        def take(message: Int32MultiArray) -> None:
            receive(set(message.data))

        self._client.node.create_subscription(Int32MultiArray, f"~/{INPUTS}", take, LATCHED_QOS)
        return partial(_publish, publisher)


def _publish(publisher: Publisher, signals: set[int]) -> None:
    publisher.publish(Int32MultiArray(data=sorted(signals)))
