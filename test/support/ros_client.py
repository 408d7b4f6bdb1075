"""What a test asks of the running nodes: services, trajectories, the newest message of a topic."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from processes import TIMEOUT
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from rx90_common.exchange.client_node import ClientNode, spoken
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_sim.node.simulation_client import SimulationClient

JOINTS = [f"joint_{i}" for i in range(1, 7)]
_AT_ONCE = 500


@contextmanager
def own_node(name: str, domain: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node(name, context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


class _Executor(SingleThreadedExecutor):
    """Takes many messages at once: rclpy's wait, between two of them, costs more than ten."""

    def __init__(self, context: Context) -> None:
        super().__init__(context=context)
        self.listening: list[tuple[Any, list[Any]]] = []

    def spin_once(self, timeout_sec: float | None = None) -> None:
        super().spin_once(timeout_sec)
        for subscription, heard in self.listening:
            for _ in range(_AT_ONCE):
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                heard.append(taken[0])


class Simulation(SimulationClient):
    def __init__(self, client: ClientNode) -> None:
        super().__init__(client)
        self._asking = client

    def step(self) -> None:
        self._trigger("step")

    def reset(self) -> None:
        self._trigger("reset")

    def _trigger(self, name: str) -> None:
        service = f"rx90_sim/{name}"
        spoken(service)(self._asking.call(Trigger, service, Trigger.Request()))


class Client:
    def __init__(self, namespace: str = "") -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("test_client", namespace=namespace, context=self._context)
        self._executor = _Executor(self._context)
        self._executor.add_node(self.node)
        self.asking = ClientNode(self.node, self._executor, TIMEOUT, lambda _: None, lambda: None)
        self.simulation = Simulation(self.asking)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(
        self, topic: str, kind: type = JointState, depth: int | QoSProfile = 1000, *, raw: bool = False
    ) -> list[Any]:
        """Return a list that grows with the messages of a topic; with a depth of 1, those there is time for."""
        heard: list[Any] = []
        subscription = self.node.create_subscription(kind, topic, heard.append, depth, raw=raw)
        self._executor.listening.append((subscription, heard))
        return heard

    def known_to(self, *nodes: str) -> None:
        """Wait until these nodes send to all that listens here: they answer a client that was made after that."""
        for node in nodes:
            self.state(node)

    def spin_until(self, condition: Callable[[], bool], what: str, timeout: float = TIMEOUT) -> None:
        """Listen until a condition holds, which may ask for the newest message of a list that is still empty."""

        def holds() -> bool:
            try:
                return condition()
            except IndexError:
                return False

        deadline = time.monotonic() + timeout
        while not holds():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s in vain for {what}")
            self._executor.spin_once(timeout_sec=0.05)

    def enable(self, on: bool) -> None:
        assert self.asking.call(SetBool, "rx90_controller/enable", SetBool.Request(data=on)).success

    def transition(self, node: str, label: str) -> bool:
        request = ChangeState.Request(transition=Transition(label=label))
        return bool(self.asking.call(ChangeState, f"{node}/change_state", request).success)

    def state(self, node: str) -> str:
        return str(self.asking.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label)

    def set_parameters(self, node: str, *, atomically: bool = False, **values: Any) -> list[str]:
        """Set parameters, `__` in the names for a dot; return for each why not, empty if it was set."""
        given = [Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()]
        if atomically:
            whole = SetParametersAtomically.Request(parameters=given)
            results = [self.asking.call(SetParametersAtomically, f"{node}/set_parameters_atomically", whole).result]
        else:
            each = SetParameters.Request(parameters=given)
            results = self.asking.call(SetParameters, f"{node}/set_parameters", each).results
        assert all(result.successful != bool(result.reason) for result in results)
        return [result.reason for result in results]

    def send(self, points: Sequence[tuple[float, Sequence[float]]], names: Sequence[str] = tuple(JOINTS)) -> None:
        position = np.array([angles for _, angles in points])
        times = np.array([time for time, _ in points])
        client = TrajectoryClient(self.asking, "rx90_controller")
        client.wait_for_controller()
        client.send(names, TrajectoryPoints(times, position, np.zeros_like(position), None))


def seconds(message: JointState) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
