"""A servo loop without ROS, ticked by hand."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from joint_moves import trajectory

from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.servo import MotorStates
from rx90_controller.trajectory.points import points_from_message
from rx90_controller.trajectory.request import GoalOptions, GoalTolerances, TrajectoryRequest
from rx90_emulator.loop.setup import Setup


class Surroundings:
    ready = "ready"

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.published: list[int] = []
        self.taken: list[tuple[int, int, str]] = []
        self.report: Callable[[], None] = lambda: None

    def info(self, text: str) -> None:
        self.lines.append(text)

    def error(self, text: str) -> None:
        self.lines.append(text)

    def wait_for_subscribers(self) -> None:
        self.lines.append("subscribers")

    def publish(self, stamp_ns: int) -> None:
        self.published.append(stamp_ns)

    def accepted(self, trajectory: SimpleNamespace, start_ns: int, source: str = "") -> None:
        self.taken.append((len(trajectory.points), start_ns, source))

    def wake(self) -> None:
        self.report()


class Rig:
    def __init__(self, setup: Setup) -> None:
        self.around = Surroundings()
        self.cs7b = setup.cs7b()
        self.names = setup.robot.joint_names
        self.loop = ServoLoop(self.cs7b, self.around, horizon=60.0)
        self.around.report = self.loop.report
        self.period = setup.rates.period_ns
        self.position = np.zeros(6)

    def states(self, tick: int) -> MotorStates:
        return MotorStates(tick * self.period, self.position, np.zeros(6))

    def run(self, first: int, count: int) -> list[bool]:
        torques = []
        for tick in range(first, first + count):
            torques.append(self.loop.step(tick * self.period, self.states(tick)))
            self.loop.after_command(tick * self.period)
        return torques

    def goal(self, message: SimpleNamespace, client: Any) -> TrajectoryRequest:
        points, tolerances = points_from_message(self.names, message), GoalTolerances.of_parameters(self.names)
        goal = TrajectoryRequest(message, points, None, tolerances, GoalOptions(), is_goal=True)
        goal.on_feedback, goal.on_result = client.on_feedback, lambda: client.on_result(goal)
        return goal

    def trajectory(self, target: float, seconds: float = 1.0, start: float = 0.0) -> SimpleNamespace:
        """Return a message that moves all joints to `target`, rad, from a time on, s; 0: now."""
        return trajectory([seconds], [target], [0.0], start=start, names=self.names)
