"""A client of the controller's action, and the simulation's time under its hand."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from processes import TIMEOUT
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.task import Future
from ros_client import JOINTS, Client
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

BASE_RATE = 4000  # Hz


def stamp(kind: Any, seconds: float) -> Any:
    sec, nanosec = divmod(round(seconds * 1e9), 10**9)
    return kind(sec=sec, nanosec=nanosec)


def point(seconds: float, positions: Sequence[float], velocities: Sequence[float] | None = None) -> Any:
    rest = [0.0] * len(positions)
    return JointTrajectoryPoint(
        positions=list(positions),
        velocities=rest if velocities is None else list(velocities),
        time_from_start=stamp(Duration, seconds),
    )


def goal(*points: Any, names: Sequence[str] = tuple(JOINTS), start: float = 0.0, **fields: Any) -> Any:
    trajectory = JointTrajectory(joint_names=list(names), points=list(points))
    trajectory.header.stamp = stamp(Time, start)
    return FollowJointTrajectory.Goal(trajectory=trajectory, **fields)


def move(to: float | Sequence[float], seconds: float = 0.2, **fields: Any) -> Any:
    return goal(point(seconds, np.broadcast_to(to, 6).tolist()), **fields)


class GoalClient:
    def __init__(self, client: Client) -> None:
        self._client = client
        self.feedback: list[Any] = []
        self._action = ActionClient(client.node, FollowJointTrajectory, "rx90_controller/follow_joint_trajectory")
        client.spin_until(self._action.server_is_ready, "the action's server")

    def there(self) -> bool:
        return bool(self._action.server_is_ready())

    def wait(self, future: Future) -> Any:
        self._client.spin_until(future.done, "an answer", TIMEOUT)
        return future.result()

    def send(self, message: Any) -> Any:
        heard = self.feedback = []
        return self.wait(self._action.send_goal_async(message, lambda sent: heard.append(sent.feedback)))

    def result_of(self, handle: Any) -> Future:
        assert handle.accepted
        return handle.get_result_async()

    def cancel(self, handle: Any) -> Any:
        return self.wait(handle.cancel_goal_async())


class Stepper:
    def __init__(self, client: Client, step: float) -> None:
        self._client, self._step, self._ticks, self._ran = client, step, 0, 0
        self._parameters = client.node.create_client(SetParameters, "rx90_sim/set_parameters")
        self._steps = client.node.create_client(Trigger, "rx90_sim/step")
        self._pauses = client.node.create_client(SetBool, "rx90_sim/pause")
        self._resets = client.node.create_client(Trigger, "rx90_sim/reset")
        client.spin_until(self._steps.service_is_ready, "the simulation")

    @property
    def ran(self) -> float:
        return self._ran / BASE_RATE

    def run(self, seconds: float) -> None:
        ticks = round(seconds / self._step) * round(self._step * BASE_RATE)
        if ticks not in (0, self._ticks):
            step_ticks = Parameter("step_ticks", value=ticks).to_parameter_msg()
            (result,) = self._ask(self._parameters, SetParameters.Request(parameters=[step_ticks])).results
            assert result.successful
            self._ticks = ticks
        if ticks:
            assert self._ask(self._steps, Trigger.Request()).success
        self._ran += ticks

    def pause(self, paused: bool) -> None:
        assert self._ask(self._pauses, SetBool.Request(data=paused)).success

    def reset(self) -> None:
        assert self._ask(self._resets, Trigger.Request()).success
        self._ran = 0

    def until(self, done: Future, most: float = 10.0) -> Any:
        end = self.ran + most
        while not done.done():
            assert self.ran < end, f"nothing within {most:g} s"
            self.run(self._step)
            self._client._executor.spin_once(timeout_sec=0.0)
        return done.result()

    def _ask(self, service: Any, request: Any) -> Any:
        answer = service.call_async(request)
        self._client.spin_until(answer.done, service.srv_name)
        return answer.result()
