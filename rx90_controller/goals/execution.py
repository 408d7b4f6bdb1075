"""What becomes of one goal, stepped once in each position tick."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.goals.results import ResultCode
from rx90_controller.goals.tolerances import QUANTITIES, GoalTolerances
from rx90_controller.trajectory import Progress


class Phase(Enum):
    """Where a goal is."""

    WAITING = "waiting"  # for its start
    RUNNING = "running"
    SETTLING = "settling"  # its last point has been commanded
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Outcome(NamedTuple):
    """How a goal has ended.

    Attributes:
        phase: SUCCEEDED, ABORTED or CANCELED, as the action's states.
        code: of the result.
        text: error_string of the result, one line.
        tick: position tick of the end.
    """

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


class Execution:
    """One goal, or a trajectory of the topic, to its end: a state machine stepped with set-points and measured states.

    Attributes:
        phase: where it is.
        feedback: how it went in the last step; None before the first.
    """

    def __init__(self, tolerances: GoalTolerances, period: float, *, waits: bool = True) -> None:
        """Hold a goal to tolerances, from its start on if it `waits`; `period` is that of the position loop, s."""
        self.phase = Phase.WAITING if waits else Phase.RUNNING
        self.feedback: Feedback | None = None
        self._tolerances, self._period = tolerances, period
        self._began = self._settling = 0

    def step(self, tick: int, desired: Array, actual: Array, progress: Progress) -> Outcome | None:
        """Compare the set-point of a position tick with the measured state; return how the goal ends, if it does.

        Along the path its tolerances hold, from the first sample to the last one before the last point. From the last
        point on the goal is reached as soon as its tolerances hold, and missed once `goal_time` is over.

        Args:
            tick: the position tick.
            desired: set-point: position rad, velocity rad/s, acceleration rad/s^2, shape (3, 6).
            actual: measured, likewise.
            progress: of the trajectory at this tick.
        """
        if self.phase is Phase.WAITING and progress.time < 0.0:
            return None
        first = self.feedback is None
        error = desired - actual
        if first:
            self.phase, self._began = Phase.RUNNING, tick
        reached = progress.time >= progress.last
        since = (tick - self._began) * self._period
        self.feedback = Feedback(tick, desired, actual, error, progress.time, since)
        if first or not reached:
            worst = self._worst(error, self._tolerances.path)
            if worst is not None:
                text = f"{worst} along the path, at {self._when(tick, progress)}"
                return self._end(Phase.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED, text, tick)
        return self._settle(tick, error, progress) if reached else None

    def end(self, phase: Phase, text: str, tick: int) -> Outcome:
        """End it from outside: CANCELED, or ABORTED, whose code is INVALID_GOAL."""
        code = ResultCode.SUCCESSFUL if phase is Phase.CANCELED else ResultCode.INVALID_GOAL
        return self._end(phase, code, text, tick)

    def _settle(self, tick: int, error: Array, progress: Progress) -> Outcome | None:
        if self.phase is not Phase.SETTLING:
            self.phase, self._settling = Phase.SETTLING, tick
        worst = self._worst(error, self._tolerances.goal)
        late = (tick - self._settling) * self._period
        if worst is None:
            text = f"goal reached at {tick * self._period:.6g} s, {late:.6g} s after the last point"
            return self._end(Phase.SUCCEEDED, ResultCode.SUCCESSFUL, text, tick)
        if late > self._tolerances.goal_time:
            text = f"{worst} at the goal, {late:.6g} s after the last point, at {self._when(tick, progress)}"
            return self._end(Phase.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, text, tick)
        return None

    def _worst(self, error: Array, limit: Array) -> str | None:
        """Return what is furthest beyond its tolerance, relatively, in words; None if nothing is."""
        beyond = ~(np.abs(error) <= limit) & np.isfinite(limit)
        if not beyond.any():
            return None
        share = np.where(beyond, np.nan_to_num(np.abs(error) / limit, nan=np.inf), -1.0)
        row, joint = divmod(int(np.argmax(share)), error.shape[1])
        quantity, unit = QUANTITIES[row]
        return (
            f"{self._tolerances.names[joint]}: {quantity} error {error[row, joint]:.4g} {unit}, accepted up to "
            f"{limit[row, joint]:.4g} {unit}"
        )

    def _when(self, tick: int, progress: Progress) -> str:
        return f"{tick * self._period:.6g} s, {progress.time:.6g} s on the trajectory"

    def _end(self, phase: Phase, code: ResultCode, text: str, tick: int) -> Outcome:
        self.phase = phase
        return Outcome(phase, code, text, tick)
