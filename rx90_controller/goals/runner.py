"""One goal after the other on the set-point generator: taken, watched, cancelled, ended."""

from __future__ import annotations

from rx90_common.base.arrays import Array
from rx90_controller.goals.execution import Event, Feedback
from rx90_controller.goals.goal import Goal, GoalOptions
from rx90_controller.trajectory import Schedule, TrajectoryGenerator


class GoalRunner:
    """Runs goals, one at a time, and says what becomes of them; counts position ticks and reads no clock.

    All calls come between ticks (under the lock of `ServoLoop`), except `check_goal`, which comes before:

    - `check_goal(message, ...)` in the executor's thread; then `offer`, which takes the goal or raises `GoalError`.
      The events that it returns (the goal before was pre-empted) are to be delivered.
    - `step` in every position tick, after the measured states of the tick have come and before `CS7B.step`: it may
      begin a stop from this tick on. It returns the end of the goal, or None.
    - `cancel` for a cancel request of the active goal: CANCELED at once, the arm stops along the path and holds.
    - `drop` when the controller stops to follow (brakes, disabled, fault, reset, deactivated, no states): ABORTED with
      INVALID_GOAL and the reason; the set-points are the caller's affair (`CS7B.reset`).
    - `preempt` when something else than a goal takes the arm (a trajectory on the topic): likewise.

    Attributes:
        active: what the running goal is known by; None if there is none.
    """

    active: object | None

    def __init__(self, trajectory: TrajectoryGenerator, options: GoalOptions) -> None:
        """Run goals on a set-point generator."""
        raise NotImplementedError

    def offer(self, key: object, goal: Goal, now: int) -> tuple[Schedule, list[Event]]:
        """Take a goal; the one before ends with INVALID_GOAL, "pre-empted".

        Args:
            key: to know the goal by in events (its handle or id).
            goal: checked.
            now: the first position tick that may still be changed, `CS7B.position_tick`.

        Raises:
            GoalError: OLD_HEADER_TIMESTAMP if all its points lie in the past; INVALID_GOAL if it starts elsewhere than
                the arm is, or a set-point is beyond a limit. The goal before goes on untouched.
        """
        raise NotImplementedError

    def step(self, tick: int, position: Array, velocity: Array) -> Event | None:
        """Compare a position tick's set-point with the measured state, joints, rad and rad/s, shape (6,) each.

        After a violated tolerance the stop along the path has begun when this returns.
        """
        raise NotImplementedError

    def cancel(self, now: int) -> Event | None:
        """Cancel the active goal and stop along the path from tick `now` on; None if there is no goal."""
        raise NotImplementedError

    def drop(self, reason: str, now: int) -> Event | None:
        """End the active goal with INVALID_GOAL and a reason; the set-points are left as they are."""
        raise NotImplementedError

    def feedback(self) -> Feedback | None:
        """Return how the active goal went in the last step; None if there is none, or no step yet."""
        raise NotImplementedError
