"""What becomes of goals, one after the other, and of trajectories that are held to tolerances: a step in each tick."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.goals.request import QUANTITIES, GoalError, GoalTolerances, ResultCode, TrajectoryRequest
from rx90_controller.trajectory import PastError, Plan, Progress, Schedule, TrajectoryGenerator, points_left
from rx90_controller.trajectory.message import check_horizon


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


class Event(NamedTuple):
    """How a goal has ended, and which: `key` is what `GoalRunner.offer` was given, None for what is watched."""

    key: object
    outcome: Outcome


class GoalRunner:
    """Runs goals, one at a time, and says what becomes of them; counts position ticks and reads no clock.

    All calls come between ticks (under the lock of `ServoLoop`), except `check_goal`, which comes before:

    - `check_goal(message, ...)` in the executor's thread; then `offer`, which takes the goal or raises `GoalError`.
      It returns the end of the goal before, which is to be delivered as the others. So with trajectories of the topic.
    - `step` after every position tick, with the set-point that this tick has had. After a violated tolerance the arm
      stops along the path from the next tick on.
    - `cancel` when the client cancels the active goal: CANCELED at once, the arm stops along the path and holds.
    - `drop` when the controller no longer follows the goal's trajectory (brakes, disabled, fault, reset, deactivated,
      no states): ABORTED with INVALID_GOAL and the reason. Set-points are left alone.

    A goal that succeeds leaves the arm at its last point. Once no goal is active there is nothing to call but `step`.

    Attributes:
        active: what the running goal is known by; None if there is none.
    """

    def __init__(self, trajectory: TrajectoryGenerator, horizon: float) -> None:
        """Run goals on a set-point generator; a start may lie up to `horizon`, s, ahead."""
        self.active: object | None = None
        self._trajectory, self._horizon = trajectory, horizon
        self._execution: Execution | None = None
        self._velocity, self._tick = np.zeros(6), -1  # of the last step, for the acceleration

    def offer(
        self, key: object | None, request: TrajectoryRequest, now: int, inactive: str = "", plan: Plan | None = None
    ) -> tuple[Schedule, Event | None]:
        """Follow a goal or a trajectory of the topic; return when, and the end of the goal before.

        Args:
            key: to know the goal by in events (its handle or id); None for a trajectory of the topic.
            request: checked.
            now: the first position tick that may still be changed, `CS7B.position_tick`.
            inactive: why nothing can be followed now, and what is accepted; empty if the controller is active.
            plan: with which it was joined beside the ticks.

        Raises:
            GoalError: OLD_HEADER_TIMESTAMP if all its points lie in the past; INVALID_GOAL if the controller is not
                active, or it starts too far ahead or elsewhere than the arm is, or a set-point is beyond a limit. The
                goal before goes on untouched.
        """
        if inactive:
            raise GoalError(ResultCode.INVALID_GOAL, inactive)
        try:
            check_horizon(request.start, now, self._horizon, self._trajectory.period)
            schedule = plan.adopt(now) if plan is not None else None
            if schedule is None:
                schedule = request.enter(self._trajectory, now)
        except PastError as error:
            raise GoalError(ResultCode.OLD_HEADER_TIMESTAMP, str(error)) from error
        except TrajectoryError as error:
            raise GoalError(ResultCode.INVALID_GOAL, str(error)) from error
        by = "pre-empted by a new goal" if request.is_goal else "replaced by a trajectory on the topic"
        ended = self.drop(by, now)
        self.active = key
        if request.is_goal or request.tolerances.end_motions:
            # What runs until a trajectory of the topic starts is watched, too.
            self._execution = Execution(request.tolerances, self._trajectory.period, waits=request.is_goal)
        return schedule, ended

    @property
    def watching(self) -> bool:
        """Return whether there is a goal, or a trajectory that is watched."""
        return self._execution is not None

    def check_future(self, goal: TrajectoryRequest, now: int) -> None:
        """Check whether a goal, offered at position tick `now`, would have a point left.

        Raises:
            GoalError: OLD_HEADER_TIMESTAMP if all its points lie in the past.
        """
        assert goal.points is not None
        try:
            points_left(goal.points, now, goal.start, self._trajectory.period)
        except PastError as error:
            raise GoalError(ResultCode.OLD_HEADER_TIMESTAMP, str(error)) from error

    def step(self, tick: int, desired: Array, position: Array, velocity: Array) -> Event | None:
        """Compare the set-point of a position tick with the measured state; return the end of the goal, if it is now.

        Args:
            tick: the position tick that has just been run.
            desired: its set-point, shape (3, 6), as `TrajectoryGenerator.setpoints` has it.
            position: measured in this tick, joints, rad, shape (6,).
            velocity: likewise, rad/s.
        """
        acceleration = (velocity - self._velocity) / self._trajectory.period if tick == self._tick + 1 else desired[2]
        self._velocity, self._tick = velocity.copy(), tick
        if self._execution is None:
            return None
        actual = np.stack([position, velocity, acceleration])
        outcome = self._execution.step(tick, desired.copy(), actual, self._trajectory.progress(tick))
        if outcome is None:
            return None
        if outcome.phase is Phase.ABORTED:
            self._trajectory.halt(tick + 1)
        return self._ended(outcome)

    def cancel(self, now: int) -> Event | None:
        """Cancel the active goal and stop along the path from tick `now` on; None if there is no goal."""
        if self._execution is None:
            return None
        schedule = self._trajectory.halt(now)
        begin, end = (tick * self._trajectory.period for tick in (schedule.begin, schedule.end))
        text = f"cancelled; stopping from {begin:.6g} s on, at rest at {end:.6g} s"
        return self._ended(self._execution.end(Phase.CANCELED, text, now))

    def drop(self, reason: str, now: int) -> Event | None:
        """End the active goal with INVALID_GOAL and a reason; set-points are left as they are. None without a goal."""
        if self._execution is None or self.active is None:
            self._execution = None
            return None
        text = f"{reason}, at {now * self._trajectory.period:.6g} s"
        return self._ended(self._execution.end(Phase.ABORTED, text, now))

    @property
    def feedback(self) -> Feedback | None:
        """Return how the active goal went in the last step; None if there is none, or it has not begun."""
        return self._execution.feedback if self._execution is not None else None

    def _ended(self, outcome: Outcome) -> Event:
        event = Event(self.active, outcome)
        self.active = self._execution = None
        return event
