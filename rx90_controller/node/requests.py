"""Trajectories sent to the controller: accepted, refused, or stopping the arm; and the lines that say so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_controller.goals.goal import GoalOptions
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import Schedule, TrajectoryPoints
from rx90_controller.trajectory.message import check_horizon, check_joint_names, points_from_message, start_tick
from rx90_controller.trajectory.planning import Entrance, Plan


class Log(Protocol):
    """Where accepted trajectories and lines for the user go."""

    def wake(self) -> None:
        """Have `Requests.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int, source: str = "") -> None:
        """Publish a trajectory that was taken, when it starts, ns, and OF_ACTION for one that was a goal."""

    def info(self, text: str) -> None:
        """Print what happened."""

    def error(self, text: str) -> None:
        """Print what went wrong."""


class TrajectoryRequest(NamedTuple):
    """A trajectory of the topic, checked by itself.

    Attributes:
        trajectory: as it came.
        start: its start in position ticks; None for now.
        entrance: how it comes into the generator; None for a stop.
    """

    trajectory: Any
    start: int | None
    entrance: Entrance | None


class Requests:
    """Hands trajectories to the set-point generator, and notes what is to be said of them until `report` says it.

    To print may take longer than a tick: the thread that ticks only notes. All but `report` and `checked` is called
    between ticks.

    Args:
        cs7b: whose generator gets them.
        log: gets what became of them.
        horizon: how far ahead of the controller's time, s, a trajectory may start.

    Attributes:
        options: what else is accepted; may be changed for the next trajectory.
        rejected: number of trajectories and goals that were refused.
        last_rejection: which was the last of them, when and why; empty before the first.
    """

    def __init__(self, cs7b: CS7B, log: Log, horizon: float) -> None:
        self._cs7b, self._log, self._horizon = cs7b, log, horizon
        self.options = GoalOptions()
        self._waiting: TrajectoryRequest | None = None
        self.rejected, self.last_rejection = 0, ""
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

    def wait(self, request: TrajectoryRequest) -> None:
        """Keep a trajectory for the first states."""
        instead = ", in place of the one that waited" if self._waiting is not None else ""
        self._waiting = request
        self.note(f"a trajectory waits for the simulation's first tick{instead}")

    def begin(self, inactive: str) -> bool:
        """Take the trajectory that has waited; return whether one is followed."""
        waiting, self._waiting = self._waiting, None
        return waiting is not None and self.take(waiting, inactive)

    def checked(self, trajectory: Any) -> TrajectoryRequest:
        """Return a trajectory_msgs/JointTrajectory, checked by itself; not between ticks, as that may take long.

        Raises:
            TrajectoryError: naming joint, index of the point and reason.
        """
        cs7b, options = self._cs7b, self.options
        start = start_tick(trajectory, cs7b.rates.position_hz)
        if not trajectory.points:
            if trajectory.joint_names:
                check_joint_names(cs7b.joint_names, trajectory)
            return TrajectoryRequest(trajectory, start, None)
        points = points_from_message(
            cs7b.joint_names,
            trajectory,
            partial=options.allow_partial_joints_goal,
            moving_end=options.allow_nonzero_velocity_at_trajectory_end,
            smooth=options.velocities_from_positions,
        ).prepared()
        anywhere = options.allow_trajectory_replacement
        return TrajectoryRequest(trajectory, start, Entrance(points, start, anywhere=anywhere, first_point=True))

    def take(self, request: TrajectoryRequest, inactive: str, plan: Plan | None = None) -> bool:
        """Follow a trajectory, or stop for one without points; return False if it is refused.

        Args:
            request: the trajectory, checked.
            inactive: why none can be followed, empty if one can.
            plan: to which it was joined, if that takes long.
        """
        try:
            if inactive:
                raise TrajectoryError(inactive)
            self._check_start(request.start)
            if request.entrance is not None:
                self._follow(request, request.entrance, plan)
            else:
                self._stop(request)
        except TrajectoryError as error:
            self.refused("trajectory", error)
            return False
        return True

    def refused(self, what: str, error: TrajectoryError) -> None:
        """Count what was refused, and note why."""
        self.count_refused(what, error)
        self.note(f"{what} rejected: {error}", wrong=True)

    def count_refused(self, what: str, error: TrajectoryError) -> None:
        """Keep for the diagnostics what was refused."""
        self.rejected += 1
        self.last_rejection = f"{what} at {self._cs7b.position_tick * self._cs7b.rates.position_period:.3f} s: {error}"

    def announce(
        self,
        what: str,
        trajectory: Any,
        points: TrajectoryPoints,
        schedule: Schedule,
        start: int | None,
        source: str = "",
    ) -> None:
        """Note that a trajectory was taken, and publish it with its start: a tick, None for when it begins."""
        rates = self._cs7b.rates
        begin = schedule.begin * rates.position_period
        text = f"{what} accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin:.3f} s"
        if points.smooth:
            text += "; velocities from its positions"
        if schedule.miss > 0.0:
            text += f"; its ramps pass the points in between at up to {schedule.miss:.3g} rad"
        self._publish(trajectory, schedule.begin if start is None else start, source)
        self.note(text)

    def _follow(self, request: TrajectoryRequest, entrance: Entrance, plan: Plan | None) -> None:
        now = self._cs7b.position_tick
        schedule = plan.adopt(now) if plan is not None else None
        if schedule is None:
            schedule = entrance.enter(self._cs7b.trajectory, now)
        self.announce("trajectory", request.trajectory, entrance.points, schedule, request.start)

    def _stop(self, request: TrajectoryRequest) -> None:
        cs7b = self._cs7b
        schedule = cs7b.trajectory.stop(cs7b.position_tick, request.start)
        begin, end = (tick * cs7b.rates.position_period for tick in (schedule.begin, schedule.end))
        self._publish(request.trajectory, schedule.begin)
        self.note(f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s")

    def _publish(self, trajectory: Any, start: int, source: str = "") -> None:
        rates = self._cs7b.rates
        self._reports.append(partial(self._log.accepted, trajectory, start * rates.period_ns * rates.ratio, source))

    def _check_start(self, start: int | None) -> None:
        rates = self._cs7b.rates
        check_horizon(start, self._cs7b.position_tick, self._horizon, rates.position_period)
