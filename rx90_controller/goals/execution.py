"""What becomes of one goal, stepped once in each position tick."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from rx90_common.base.arrays import Array
from rx90_controller.goals.results import ResultCode


class Phase(Enum):
    """Where a goal is."""

    WAITING = "waiting"  # for its start
    RUNNING = "running"
    SETTLING = "settling"  # its last point has been commanded
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Event(NamedTuple):
    """How a goal has ended.

    Attributes:
        goal: what `GoalRunner.offer` was given to know it by.
        phase: SUCCEEDED, ABORTED or CANCELED, as the action's states.
        code: of the result.
        text: error_string of the result, one line.
        tick: position tick of the end.
    """

    goal: object
    phase: Phase
    code: ResultCode
    text: str
    tick: int


class Feedback(NamedTuple):
    """How a goal goes at a position tick.

    Attributes:
        tick: position tick.
        desired: set-point: position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
        actual: measured, shape (3, 6); the acceleration is the difference of the velocities over a tick.
        error: desired less actual, shape (3, 6).
        desired_time: time on the trajectory, s from its start; slower than `actual_time` where speed is scaled.
        actual_time: time since its start, s.
    """

    tick: int
    desired: Array
    actual: Array
    error: Array
    desired_time: float
    actual_time: float
