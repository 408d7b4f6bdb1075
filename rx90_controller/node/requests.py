"""Trajectories sent to the controller: accepted, refused, or stopping the arm; and the lines that say so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import Schedule
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
        rejected: number of trajectories that were refused.
    """

    def __init__(self, cs7b: CS7B, log: Log, horizon: float) -> None:
        self._cs7b, self._log, self._horizon = cs7b, log, horizon
        self.rejected = 0
        self._reports: deque[Callable[[], None]] = deque()

    def report(self) -> None:
        """Print and publish what there is to say."""
        while self._reports:
            self._reports.popleft()()

    def later(self, call: Callable[[], None]) -> None:
        """Have `report` call this, in its turn."""
        self._reports.append(call)
        self._log.wake()

    def note(self, text: str, *, wrong: bool = False) -> None:
        """Note a line."""
        self.later(partial(self._log.error if wrong else self._log.info, text))

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

    def take(self, trajectory: Any, *, enabled: bool) -> None:
        """Follow a trajectory_msgs/JointTrajectory, or stop for one without points, or refuse it."""
        try:
            if not enabled:
                raise TrajectoryError("the controller is disabled; accepted: after a call of ~/enable with true")
            schedule, text = self._follow(trajectory) if trajectory.points else self._stop(trajectory)
        except TrajectoryError as error:
            self.rejected += 1
            self.note(f"trajectory rejected: {error}", wrong=True)
            return
        rates = self._cs7b.rates
        self._reports.append(partial(self._log.accepted, trajectory, schedule.begin * rates.period_ns * rates.ratio))
        self.note(text)

    def _follow(self, trajectory: Any) -> tuple[Schedule, str]:
        cs7b = self._cs7b
        points = points_from_message(cs7b.joint_names, trajectory)
        schedule = cs7b.trajectory.accept(points, cs7b.position_tick, self._start(trajectory))
        begin = schedule.begin * cs7b.rates.position_period
        text = f"trajectory accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin:.3f} s"
        if schedule.miss > 0.0:
            text += f"; its ramps pass the points in between at up to {schedule.miss:.3g} rad"
        return schedule, text

    def _stop(self, trajectory: Any) -> tuple[Schedule, str]:
        cs7b = self._cs7b
        if trajectory.joint_names:
            check_joint_names(cs7b.joint_names, trajectory)
        schedule = cs7b.trajectory.stop(cs7b.position_tick, self._start(trajectory))
        begin, end = (tick * cs7b.rates.position_period for tick in (schedule.begin, schedule.end))
        return schedule, f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s"

    def _start(self, trajectory: Any) -> int | None:
        """Return the start tick of a message, None for now.

        Raises:
            TrajectoryError: if it is further ahead than the horizon.
        """
        rates = self._cs7b.rates
        start = start_tick(trajectory, rates.position_hz)
        check_horizon(start, self._cs7b.position_tick, self._horizon, rates.position_period)
        return start
