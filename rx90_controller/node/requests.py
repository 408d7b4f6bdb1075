"""Trajectories sent to the controller: accepted, refused, or stopping the arm; and the lines that say so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_controller.goals.goal import GoalOptions
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import Schedule, TrajectoryPoints
from rx90_controller.trajectory.message import check_horizon, check_joint_names, points_from_message, start_tick


class Log(Protocol):
    """Where accepted trajectories and lines for the user go."""

    def wake(self) -> None:
        """Have `Requests.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int) -> None:
        """Publish a trajectory that was taken, and when it starts, ns."""

    def info(self, text: str) -> None:
        """Print what happened."""

    def error(self, text: str) -> None:
        """Print what went wrong."""


class Requests:
    """Hands trajectories to the set-point generator, and notes what is to be said of them until `report` says it.

    To print may take longer than a tick: the thread that ticks only notes. All but `report` is called between ticks.

    Args:
        cs7b: whose generator gets them.
        log: gets what became of them.
        horizon: how far ahead of the controller's time, s, a trajectory may start.

    Attributes:
        options: what else is accepted; may be changed for the next trajectory.
        rejected: number of trajectories that were refused.
    """

    def __init__(self, cs7b: CS7B, log: Log, horizon: float) -> None:
        self._cs7b, self._log, self._horizon = cs7b, log, horizon
        self.options = GoalOptions()
        self._waiting: Any = None
        self.rejected = 0
        self._reports: deque[Callable[[], None]] = deque()

    def report(self) -> None:
        """Print and publish what there is to say."""
        while self._reports:
            self._reports.popleft()()

    def post(self, call: Callable[[], None]) -> None:
        """Have something done by `report`, after what was noted before."""
        self._reports.append(call)
        self._log.wake()

    def note(self, text: str, *, wrong: bool = False) -> None:
        """Note a line."""
        self.post(partial(self._log.error if wrong else self._log.info, text))

    def note_end(self) -> None:
        """Note the end of a trajectory, if it is in this tick of the position loop."""
        end = self._cs7b.trajectory.ended(self._cs7b.position_tick)
        if end is not None:
            what = "stopped" if end.stop else "trajectory ended"
            self.note(f"{what} at {end.tick * self._cs7b.rates.position_period:.3f} s; holding")

    def note_dropped(self, why: str) -> None:
        """Note that a trajectory comes to no end, if one runs or waits for its start."""
        now = self._cs7b.position_tick
        if self._cs7b.trajectory.moving(now):
            self.note(f"trajectory dropped at {now * self._cs7b.rates.position_period:.3f} s: {why}")

    def wait(self, trajectory: Any) -> None:
        """Keep a trajectory for the first states."""
        instead = ", in place of the one that waited" if self._waiting is not None else ""
        self._waiting = trajectory
        self.note(f"a trajectory waits for the simulation's first tick{instead}")

    def begin(self, inactive: str) -> None:
        """Take the trajectory that has waited, if there is one."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self.take(waiting, inactive)

    def take(self, trajectory: Any, inactive: str) -> bool:
        """Follow a trajectory_msgs/JointTrajectory, or stop for one without points; return False if it is refused.

        `inactive` is why none can be followed, empty if one can.
        """
        try:
            if inactive:
                raise TrajectoryError(inactive)
            if trajectory.points:
                self._follow(trajectory)
            else:
                self._stop(trajectory)
        except TrajectoryError as error:
            self.refused("trajectory", error)
            return False
        return True

    def refused(self, what: str, error: TrajectoryError) -> None:
        """Count what was refused, and note why."""
        self.rejected += 1
        self.note(f"{what} rejected: {error}", wrong=True)

    def announce(
        self, what: str, trajectory: Any, points: TrajectoryPoints, schedule: Schedule, start: int | None
    ) -> None:
        """Note that a trajectory was taken, and publish it with its start: a tick, None for when it begins."""
        rates = self._cs7b.rates
        begin = schedule.begin * rates.position_period
        text = f"{what} accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin:.3f} s"
        if points.smooth:
            text += "; velocities from its positions"
        if schedule.miss > 0.0:
            text += f"; its ramps pass the points in between at up to {schedule.miss:.3g} rad"
        self._publish(trajectory, schedule.begin if start is None else start)
        self.note(text)

    def _follow(self, trajectory: Any) -> None:
        cs7b, options = self._cs7b, self.options
        points = points_from_message(
            cs7b.joint_names,
            trajectory,
            partial=options.allow_partial_joints_goal,
            moving_end=options.allow_nonzero_velocity_at_trajectory_end,
            smooth=options.velocities_from_positions,
        )
        start = self._start(trajectory)
        if options.allow_trajectory_replacement:
            schedule = cs7b.trajectory.join(points, cs7b.position_tick, start, anywhere=True)
        else:
            schedule = cs7b.trajectory.accept(points, cs7b.position_tick, start)
        self.announce("trajectory", trajectory, points, schedule, start)

    def _stop(self, trajectory: Any) -> None:
        cs7b = self._cs7b
        if trajectory.joint_names:
            check_joint_names(cs7b.joint_names, trajectory)
        schedule = cs7b.trajectory.stop(cs7b.position_tick, self._start(trajectory))
        begin, end = (tick * cs7b.rates.position_period for tick in (schedule.begin, schedule.end))
        self._publish(trajectory, schedule.begin)
        self.note(f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s")

    def _publish(self, trajectory: Any, start: int) -> None:
        rates = self._cs7b.rates
        self._reports.append(partial(self._log.accepted, trajectory, start * rates.period_ns * rates.ratio))

    def _start(self, trajectory: Any) -> int | None:
        """Return the start tick of a message, None for now.

        Raises:
            TrajectoryError: if it is further ahead than the horizon.
        """
        rates = self._cs7b.rates
        start = start_tick(trajectory, rates.position_hz)
        check_horizon(start, self._cs7b.position_tick, self._horizon, rates.position_period)
        return start
