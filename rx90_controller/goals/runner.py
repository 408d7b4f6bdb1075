"""One goal after the other on the set-point generator: taken, watched, cancelled, ended."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.goals.execution import Execution, Feedback, Outcome, Phase
from rx90_controller.goals.goal import Goal, GoalOptions
from rx90_controller.goals.results import GoalError, ResultCode
from rx90_controller.goals.tolerances import GoalTolerances
from rx90_controller.trajectory import PastError, Schedule, TrajectoryGenerator, points_left
from rx90_controller.trajectory.message import check_horizon
from rx90_controller.trajectory.planning import Plan


class Event(NamedTuple):
    """How a goal has ended, and which: `key` is what `GoalRunner.offer` was given, None for what is watched."""

    key: object
    outcome: Outcome


class GoalRunner:
    """Runs goals, one at a time, and says what becomes of them; counts position ticks and reads no clock.

    All calls come between ticks (under the lock of `ServoLoop`), except `check_goal`, which comes before:

    - `check_goal(message, ...)` in the executor's thread; then `offer`, which takes the goal or raises `GoalError`.
      It returns the end of the goal before, which is to be delivered as the others.
    - `step` after every position tick, with the set-point that this tick has had. After a violated tolerance the arm
      stops along the path from the next tick on.
    - `cancel` when the client cancels the active goal: CANCELED at once, the arm stops along the path and holds.
    - `drop` when the controller no longer follows the goal's trajectory (brakes, disabled, fault, reset, deactivated,
      no states, or a trajectory on the topic): ABORTED with INVALID_GOAL and the reason. Set-points are left alone.
    - `watch` for a trajectory of the topic, until the next of these calls.

    A goal that succeeds leaves the arm at its last point. Once no goal is active there is nothing to call but `step`.

    Attributes:
        options: what else is accepted; may be changed for the next goal.
        active: what the running goal is known by; None if there is none.
    """

    def __init__(self, trajectory: TrajectoryGenerator, options: GoalOptions, horizon: float) -> None:
        """Run goals on a set-point generator; a start may lie up to `horizon`, s, ahead."""
        self.options = options
        self.active: object | None = None
        self._trajectory, self._horizon = trajectory, horizon
        self._execution: Execution | None = None
        self._velocity, self._tick = np.zeros(6), -1  # of the last step, for the acceleration

    def offer(
        self, key: object, goal: Goal, now: int, inactive: str = "", plan: Plan | None = None
    ) -> tuple[Schedule, Event | None]:
        """Take a goal; the one before ends with INVALID_GOAL, "pre-empted".

        Args:
            key: to know the goal by in events (its handle or id), not None.
            goal: checked.
            now: the first position tick that may still be changed, `CS7B.position_tick`.
            inactive: why no goal can be taken now, and what is accepted; empty if the controller is active.
            plan: to which the goal was joined.

        Raises:
            GoalError: OLD_HEADER_TIMESTAMP if all its points lie in the past; INVALID_GOAL if the controller is not
                active, or the goal starts too far ahead or elsewhere than the arm is, or a set-point is beyond a
                limit. The goal before goes on untouched.
        """
        if inactive:
            raise GoalError(ResultCode.INVALID_GOAL, inactive)
        try:
            check_horizon(goal.start, now, self._horizon, self._trajectory.period)
            schedule = plan.adopt(now) if plan is not None else None
            if schedule is None:
                schedule = goal.entrance(self.options).enter(self._trajectory, now)
        except PastError as error:
            raise GoalError(ResultCode.OLD_HEADER_TIMESTAMP, str(error)) from error
        except TrajectoryError as error:
            raise GoalError(ResultCode.INVALID_GOAL, str(error)) from error
        ended = self.drop("pre-empted by a new goal", now)
        self.active, self._execution = key, Execution(goal.tolerances, self._trajectory.period)
        return schedule, ended

    def watch(self, tolerances: GoalTolerances) -> None:
        """Hold the trajectory that was taken last to tolerances, and what runs until it starts; without a goal."""
        if tolerances.end_motions:
            self._execution = Execution(tolerances, self._trajectory.period, waits=False)

    @property
    def watching(self) -> bool:
        """Return whether there is a goal, or a trajectory that is watched."""
        return self._execution is not None

    def check_future(self, goal: Goal, now: int) -> None:
        """Check whether a goal, offered at position tick `now`, would have a point left.

        Raises:
            GoalError: OLD_HEADER_TIMESTAMP if all its points lie in the past.
        """
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
