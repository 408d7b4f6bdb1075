"""Goals of FollowJointTrajectory as messages, and an arm that follows them without ROS."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from joint_moves import HOME, NAMES, PERIOD, ZERO

from rx90_common.base.arrays import Array
from rx90_common.base.rates import Rates
from rx90_controller.node.requests import Requests
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator
from rx90_controller.trajectory.request import (
    Feedback,
    GoalError,
    GoalOptions,
    GoalTolerances,
    Outcome,
    TrajectoryRequest,
    check_request,
)

LIMITS = JointLimits(NAMES, np.full(6, -2.0), np.full(6, 2.0), np.full(6, 3.0), np.full(6, 20.0), 1e-3)
DEFAULTS = GoalTolerances.of_parameters(
    NAMES,
    {
        "constraints.goal_time": 0.5,
        "constraints.stopped_velocity_tolerance": 0.02,
        "constraints.joint_2.trajectory": 0.05,
        "constraints.joint_3.goal": 0.01,
    },
)


def stamp(seconds: float) -> SimpleNamespace:
    """Return a Time or Duration."""
    sec, nanosec = divmod(round(seconds * 1e9), 10**9)
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> SimpleNamespace:
    """Return a JointTolerance."""
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def message(to: Array | None = None, seconds: float = 0.6, **changed: Any) -> SimpleNamespace:
    """Return a goal of a move to a pose at rest; parts of it, or of its trajectory, are changed."""
    point = SimpleNamespace(
        positions=list(HOME + 0.2 if to is None else to),
        velocities=[0.0] * 6,
        accelerations=[],
        effort=[],
        time_from_start=stamp(seconds),
    )
    trajectory = SimpleNamespace(header=SimpleNamespace(stamp=stamp(0.0)), joint_names=list(NAMES), points=[point])
    goal = SimpleNamespace(
        trajectory=trajectory,
        multi_dof_trajectory=SimpleNamespace(joint_names=[], points=[]),
        path_tolerance=[],
        component_path_tolerance=[],
        goal_tolerance=[],
        component_goal_tolerance=[],
        goal_time_tolerance=stamp(0.0),
    )
    for name, value in changed.items():
        for part in (goal, trajectory, point):
            if hasattr(part, name):
                setattr(part, name, value)
        if name == "stamp":
            trajectory.header.stamp = stamp(value)
    return goal


def checked(goal: SimpleNamespace, **options: bool) -> TrajectoryRequest:
    """Return a checked goal."""
    return check_request(goal.trajectory, DEFAULTS, GoalOptions(**options), 1000, goal)


def two(first: float, second: float) -> list[SimpleNamespace]:
    """Return two points at times, s."""
    points = message().trajectory.points * 2
    points = [copy.copy(point) for point in points]
    points[0].time_from_start, points[1].time_from_start = stamp(first), stamp(second)
    return points


class Event(NamedTuple):
    """How a goal has ended, and which."""

    key: str
    outcome: Outcome


class Arm:
    """A queue of requests, its generator, and an arm whose state is the set-point plus an error that a test sets.

    Attributes:
        feedback: the newest of the active goal.
        active: key of the goal that is followed, if there is one.
    """

    def __init__(self, **options: bool) -> None:
        self.trajectory = TrajectoryGenerator(LIMITS, PERIOD, HOME)
        self.joint_names, self.rates, self.position_tick = NAMES, Rates(), 0
        self.setpoint, self.off, self.off_speed = np.array([HOME, ZERO, ZERO]), ZERO.copy(), ZERO.copy()
        outputs: Any = mock.Mock()
        law: Any = self
        self.requests = Requests(law, outputs, 10.0, 1)
        self.options = options
        self.setpoints: list[Array] = []
        self.active: str | None = None
        self.feedback: Feedback | None = None
        self._goals: dict[str, TrajectoryRequest] = {}
        self._ended: list[Event] = []

    @property
    def tick(self) -> int:
        """Return the next tick."""
        return self.position_tick

    def measured(self) -> tuple[Array, Array]:
        """Return where the arm is and how fast."""
        return self.setpoint[0] - self.off, self.setpoint[1] - self.off_speed

    def offer(self, key: str, goal: SimpleNamespace | TrajectoryRequest, inactive: str = "") -> Event | None:
        """Offer a goal now; return the event of the one before, and raise what it is refused for."""
        request = goal if isinstance(goal, TrajectoryRequest) else checked(goal, **self.options)
        request.client = mock.Mock()
        self.requests.follow(request, inactive)
        if request.outcome is not None:
            raise GoalError(request.outcome.code, request.outcome.text)
        self._goals[key] = request
        events = self.events()
        self.active = key
        return events[0] if events else None

    def cancel(self) -> Event | None:
        """Cancel the goal offered last."""
        self.requests.cancel([*self._goals.values()][-1])
        return next(iter(self.events()), None)

    def drop(self, reason: str) -> Event | None:
        """End the goal for a reason."""
        self.requests.drop(reason)
        return next(iter(self.events()), None)

    def events(self) -> list[Event]:
        """Return which goals have ended since the last call."""
        found = [Event(key, goal.outcome) for key, goal in self._goals.items() if goal.outcome is not None]
        new, self._ended = [event for event in found if event not in self._ended], found
        if new:
            self.active = self.feedback = None
        return new

    def run(self, ticks: int) -> list[Event]:
        """Run ticks; return the events."""
        events = []
        for _ in range(ticks):
            self.setpoint = self.trajectory.setpoints(self.position_tick)[0]
            self.setpoints.append(self.setpoint)
            self.position_tick += 1
            self.requests.step()
            events += self.events()
            self.feedback = self._goals[self.active].feedback if self.active is not None else None
        return events

    def stopped_smoothly(self) -> bool:
        """Return whether the velocities never stepped by more than the accelerations allow, and the arm rests."""
        speed = np.array(self.setpoints)[:, 1]
        return bool((np.abs(np.diff(speed, axis=0)) <= 20.0 * PERIOD * (1 + 1e-6)).all() and not speed[-1].any())
