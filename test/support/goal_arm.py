"""Goals of FollowJointTrajectory as messages, and an arm that follows them without ROS."""

from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from joint_moves import HOME, NAMES, PERIOD, ZERO, stamp, trajectory

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import Rates
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.servo import MotorStates
from rx90_controller.servo.states import Holding
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator
from rx90_controller.trajectory.request import (
    Constraints,
    GoalOptions,
    GoalTolerances,
    ResultCode,
    State,
    TrajectoryRequest,
    check_request,
)

LIMITS = JointLimits(NAMES, np.full(6, -2.0), np.full(6, 2.0), np.full(6, 3.0), np.full(6, 20.0), 1e-3)
DEFAULTS = GoalTolerances.of_parameters(
    NAMES,
    Constraints(goal_time=0.5, stopped_velocity_tolerance=0.02, joint_2={"trajectory": 0.05}, joint_3={"goal": 0.01}),
)


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def message(to: Array | None = None, seconds: float = 0.6, **changed: Any) -> SimpleNamespace:
    move = trajectory([seconds], [HOME + 0.2 if to is None else to], [0.0])
    goal = SimpleNamespace(
        trajectory=move,
        multi_dof_trajectory=SimpleNamespace(joint_names=[], points=[]),
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=[],
        component_goal_tolerance=[],
        goal_time_tolerance=stamp(0.0),
    )
    for name, value in changed.items():
        for part in (goal, move, *move.points):
            if hasattr(part, name):
                setattr(part, name, value)
        if name == "stamp":
            move.header.stamp = stamp(value)
    return goal


def checked(goal: SimpleNamespace, **options: bool) -> TrajectoryRequest:
    return check_request(goal.trajectory, DEFAULTS, GoalOptions(**options), 1000, goal)


class Event(NamedTuple):
    key: str
    state: State
    code: ResultCode
    text: str
    tick: int


class GoalError(TrajectoryError):
    def __init__(self, code: ResultCode, text: str) -> None:
        super().__init__(text)
        self.code = code


class Law:
    """What a servo loop needs of a control law; each tick is one of the position loop."""

    joint_names, rates, command, fault, on_position_tick = NAMES, Rates(1000, 1000), ZERO, None, True

    def __init__(self, trajectory: TrajectoryGenerator) -> None:
        self.trajectory, self.position_tick = trajectory, 0
        self.setpoint, self.off, self.off_speed = np.array([HOME, ZERO, ZERO]), ZERO.copy(), ZERO.copy()

    def step(self, *_: object) -> None:
        self.setpoint = self.trajectory.setpoints(self.position_tick)[0]
        self.position_tick += 1

    def measured(self) -> tuple[Array, Array]:
        return self.setpoint[0] - self.off, self.setpoint[1] - self.off_speed


class Arm:
    """A servo loop, and an arm whose state is the set-point plus an error that a test sets; `active`: a goal's key."""

    def __init__(self, **options: bool) -> None:
        self.trajectory = TrajectoryGenerator(LIMITS, PERIOD, HOME)
        self.law = Law(self.trajectory)
        self.off, self.off_speed = self.law.off, self.law.off_speed
        self.outputs: Any = mock.Mock()
        law: Any = self.law
        self.loop = ServoLoop(law, self.outputs, 10.0, 1)
        self.loop.state = Holding()
        self.options = options
        self.setpoints: list[Array] = []
        self.active: str | None = None
        self._ended: list[Event] = []

    @property
    def tick(self) -> int:
        return self.law.position_tick

    def offer(self, key: str, goal: SimpleNamespace) -> Event | None:
        request = checked(goal, **self.options)
        request.on_result = lambda: self._note(key, request)
        self.loop.offer(request)
        events = self._events()
        if request.reason:
            raise GoalError(request.code, request.reason)
        self.active = key
        return events[0] if events else None

    def _note(self, key: str, goal: TrajectoryRequest) -> None:
        self._ended.append(Event(key, goal.state, goal.code, goal.reason, self.tick))
        if key == self.active:
            self.active = None

    def _events(self) -> list[Event]:
        self.loop.report()
        ended, self._ended = self._ended, []
        return ended

    def run(self, ticks: int) -> list[Event]:
        events = []
        for _ in range(ticks):
            self.loop.step(self.tick * 1_000_000, MotorStates(0, ZERO, ZERO))
            self.setpoints.append(self.law.setpoint)
            self.loop.after_command(0)
            events += self._events()
        return events

    def stopped_smoothly(self) -> bool:
        speed = np.array(self.setpoints)[:, 1]
        return bool((np.abs(np.diff(speed, axis=0)) <= 20.0 * PERIOD * (1 + 1e-6)).all() and not speed[-1].any())
