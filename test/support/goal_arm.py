"""Goals of FollowJointTrajectory as messages, and an arm that follows them without ROS."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
from joint_moves import HOME, NAMES, PERIOD, ZERO

from rx90_common.base.arrays import Array
from rx90_controller.goals.execution import Event, GoalRunner
from rx90_controller.goals.request import GoalOptions, GoalTolerances, check_goal
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator

LIMITS = JointLimits(NAMES, np.full(6, -2.0), np.full(6, 2.0), np.full(6, 3.0), np.full(6, 20.0), 1e-3)
DEFAULTS = GoalTolerances.defaults(
    NAMES, goal_time=0.5, stopped_velocity_tolerance=0.02, trajectory={"joint_2": 0.05}, goal={"joint_3": 0.01}
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


def checked(goal: SimpleNamespace, **options: bool) -> Any:
    """Return a checked goal."""
    return check_goal(goal, NAMES, DEFAULTS, GoalOptions(**options), 1000)


def two(first: float, second: float) -> list[SimpleNamespace]:
    """Return two points at times, s."""
    points = message().trajectory.points * 2
    points = [copy.copy(point) for point in points]
    points[0].time_from_start, points[1].time_from_start = stamp(first), stamp(second)
    return points


class Arm:
    """A runner, its generator, and an arm whose state is the set-point plus an error that a test sets."""

    def __init__(self, **options: bool) -> None:
        self.trajectory = TrajectoryGenerator(LIMITS, PERIOD, HOME)
        self.runner = GoalRunner(self.trajectory, 10.0)
        self.options = options
        self.tick = 0
        self.off, self.off_speed = ZERO.copy(), ZERO.copy()
        self.setpoints: list[Array] = []

    def offer(self, key: str, goal: SimpleNamespace, inactive: str = "") -> Event | None:
        """Offer a goal now; return the event of the one before."""
        return self.runner.offer(key, checked(goal, **self.options), self.tick, inactive)[1]

    def run(self, ticks: int) -> list[Event]:
        """Run ticks; return the events."""
        events = []
        for _ in range(ticks):
            desired = self.trajectory.setpoints(self.tick)[0]
            self.setpoints.append(desired)
            event = self.runner.step(self.tick, desired, desired[0] - self.off, desired[1] - self.off_speed)
            events += [event] if event is not None else []
            self.tick += 1
        return events

    def stopped_smoothly(self) -> bool:
        """Return whether the velocities never stepped by more than the accelerations allow, and the arm rests."""
        speed = np.array(self.setpoints)[:, 1]
        return bool((np.abs(np.diff(speed, axis=0)) <= 20.0 * PERIOD * (1 + 1e-6)).all() and not speed[-1].any())
