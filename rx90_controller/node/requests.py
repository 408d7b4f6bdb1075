"""Trajectories of the topic and goals of the action on the controller's ticks, and what is said of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import one_line
from rx90_common.exchange.topics import OF_ACTION
from rx90_controller.goals.execution import Event, Feedback, GoalRunner, Outcome, Phase
from rx90_controller.goals.request import (
    GoalError,
    GoalOptions,
    GoalTolerances,
    ResultCode,
    TrajectoryRequest,
    check_trajectory,
)
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import Plan, Schedule


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


class Sender(Protocol):
    """Who sent a goal; called by the executor's thread, in the order of what has happened."""

    def on_feedback(self, feedback: Feedback) -> None:
        """Hear how the goal goes."""

    def on_result(self, outcome: Outcome) -> None:
        """Hear how it has ended; the last call."""


class _Waiting(NamedTuple):
    """What waits for the first states; a trajectory of the topic has no sender."""

    sender: Sender | None
    request: TrajectoryRequest


class Requests:
    """Hands trajectories and goals to the set-point generator, and notes what is to be said until `report` says it.

    To print may take longer than a tick: the thread that ticks only notes. All but `report`, `post` and `checked` is
    called between ticks.

    Args:
        cs7b: whose generator follows them.
        log: gets what became of them.
        horizon: how far ahead of the controller's time, s, one may start.
        monitor_ticks: position ticks from one feedback to the next.

    Attributes:
        options: what else is accepted; may be changed for the next ones.
        tolerances: of goals that have none of their own, and of trajectories; may be changed for the next ones.
        rejected: number of trajectories and goals that were refused.
        last_rejection: which was the last of them, when and why; empty before the first.
    """

    def __init__(self, cs7b: CS7B, log: Log, horizon: float, monitor_ticks: int) -> None:
        self._cs7b, self._log, self._monitor_ticks = cs7b, log, monitor_ticks
        self._runner = GoalRunner(cs7b.trajectory, horizon)
        self.options, self.tolerances = GoalOptions(), GoalTolerances.defaults(cs7b.joint_names)
        self._waiting: _Waiting | None = None
        self.rejected, self.last_rejection = 0, ""
        self._reports: deque[Callable[[], None]] = deque()

    # What is to be said.

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

    def note_dropped(self, why: str) -> None:
        """Note that a trajectory comes to no end, if one runs or waits for its start."""
        now = self._cs7b.position_tick
        if self._cs7b.trajectory.moving(now):
            self.note(f"trajectory dropped at {now * self._cs7b.rates.position_period:.3f} s: {why}")

    def refused(self, what: str, error: TrajectoryError) -> None:
        """Count what was refused, and note why."""
        self._count_refused(what, error)
        self.note(f"{what} rejected: {error}", wrong=True)

    def _count_refused(self, what: str, error: TrajectoryError) -> None:
        self.rejected += 1
        self.last_rejection = f"{what} at {self._cs7b.position_tick * self._cs7b.rates.position_period:.3f} s: {error}"

    # The ticking thread.

    def begin(self, inactive: str) -> None:
        """Take what has waited for the first states."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self.take(waiting.request, inactive, sender=waiting.sender)

    def note_end(self) -> None:
        """Note the end of a trajectory, if it is in this tick of the position loop."""
        end = self._cs7b.trajectory.ended(self._cs7b.position_tick)
        if end is not None:
            what = "stopped" if end.stop else "trajectory ended"
            self.note(f"{what} at {end.tick * self._cs7b.rates.position_period:.3f} s; holding")

    def step(self) -> None:
        """Watch the active goal or trajectory, if there is one, after a tick of the position loop."""
        runner = self._runner
        if not runner.watching:
            return
        cs7b = self._cs7b
        tick = cs7b.position_tick - 1
        sender: Any = runner.active
        event = runner.step(tick, cs7b.setpoint, *cs7b.measured())
        if sender is None:
            if event is not None and event.outcome.phase is Phase.ABORTED:
                self.note(f"trajectory aborted: {event.outcome.text}; stopping and holding", wrong=True)
        elif event is not None:
            self._deliver(event.outcome, sender)
        elif tick % self._monitor_ticks == 0 and runner.feedback is not None:
            self.post(partial(sender.on_feedback, runner.feedback))

    # Either thread.

    @property
    def pending(self) -> bool:
        """Return whether a goal is active, or waits for the first states."""
        return self._runner.active is not None or (self._waiting is not None and self._waiting.sender is not None)

    def drop(self, reason: str, *, halt: bool = False, wanted: bool = False) -> None:
        """End the goal, if there is one, with -1 and a reason: `halt` on its path; `wanted`, so nothing went wrong."""
        now = self._cs7b.position_tick
        waiting = self._waiting
        if waiting is not None and waiting.sender is not None:
            self._waiting = None
            self._deliver(Outcome(Phase.ABORTED, ResultCode.INVALID_GOAL, reason, now), waiting.sender, wanted=wanted)
        active = self._runner.active
        self._deliver_event(self._runner.drop(reason, now), wanted=wanted)
        if halt and active is not None:
            self._cs7b.trajectory.halt(now)

    # The executor's thread.

    def checked(self, trajectory: Any) -> TrajectoryRequest:
        """Return a trajectory of the topic, checked by itself; not between ticks, as that may take long.

        Raises:
            TrajectoryError: naming joint, index of the point and reason.
        """
        names, rate = self._cs7b.joint_names, self._cs7b.rates.position_hz
        return check_trajectory(trajectory, names, self.tolerances, self.options, rate)

    def check(self, goal: TrajectoryRequest, inactive: str) -> None:
        """Check whether a goal may be taken, wherever the arm is.

        Raises:
            GoalError: if the controller is not active, for this reason, or if the goal's last point is over.
        """
        if inactive:
            raise GoalError(ResultCode.INVALID_GOAL, inactive)
        self._runner.check_future(goal, self._cs7b.position_tick)

    def wait(self, request: TrajectoryRequest, sender: Sender | None = None) -> None:
        """Keep a trajectory, or a goal with its sender, for the first states."""
        replaces = self._waiting is not None and self._waiting.sender is None
        instead = ", in place of the one that waited" if replaces else ""
        self.drop(_replaced(request), wanted=True)
        self._waiting = _Waiting(sender, request)
        self.note(f"a {_kind(request)} waits for the simulation's first tick{instead}")

    def plan(self, request: TrajectoryRequest, attempt: int) -> Plan:
        """Return what is to be joined beside the ticks; each attempt, from 0 on, has more time."""
        return request.plan(self._cs7b.trajectory, self._cs7b.position_tick, attempt)

    def fits(self, plan: Plan) -> bool:
        """Return whether a plan can be adopted, or says why not, in this tick."""
        return plan.fits(self._cs7b.position_tick)

    def take(
        self, request: TrajectoryRequest, inactive: str, plan: Plan | None = None, sender: Sender | None = None
    ) -> None:
        """Follow a trajectory or a goal in place of what runs, or refuse it and let that go on.

        Args:
            request: checked.
            inactive: why nothing can be followed now, and what is accepted; empty if something can.
            plan: with which it was joined, if it takes long.
            sender: of a goal, who hears of it.
        """
        now = self._cs7b.position_tick
        try:
            schedule, ended = self._runner.offer(sender, request, now, inactive, plan)
        except GoalError as error:
            if sender is None:
                self.refused("trajectory", error)
            else:
                self._count_refused("goal", error)
                self._deliver(Outcome(Phase.ABORTED, error.code, str(error), now), sender)
            return
        self._deliver_event(ended, wanted=True)
        self._announce(request, schedule)

    def scale(self, factor: float) -> None:
        """Follow trajectories at this share of their speed.

        Raises:
            TrajectoryError: if it is not a number in [0, 1].
        """
        self._cs7b.trajectory.set_speed_scaling(factor, self._cs7b.position_tick)

    def state(self, tick: float) -> tuple[Array, bool]:
        """Return the set-point at a time in position ticks, shape (3, 6), and whether a motion runs, or ends, then.

        Raises:
            TrajectoryError: for a time before the running motion.
        """
        trajectory = self._cs7b.trajectory
        return trajectory.state(tick), trajectory.moving(math.ceil(tick) - 1)

    def cancel(self, sender: Sender) -> None:
        """Cancel a goal; one that has ended meanwhile keeps its end."""
        now = self._cs7b.position_tick
        if self._waiting is not None and self._waiting.sender is sender:
            self._waiting = None
            text = "cancelled before the simulation's first tick"
            self._deliver(Outcome(Phase.CANCELED, ResultCode.SUCCESSFUL, text, now), sender)
        elif self._runner.active is sender:
            self._deliver_event(self._runner.cancel(now))

    def _announce(self, request: TrajectoryRequest, schedule: Schedule) -> None:
        """Note what was taken, and publish it with its start."""
        rates, points = self._cs7b.rates, request.points
        begin, end = (tick * rates.position_period for tick in (schedule.begin, schedule.end))
        start = schedule.begin if request.start is None else request.start
        if points is None:
            start = schedule.begin
            text = f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s"
        else:
            text = f"{_kind(request)} accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin:.3f} s"
            if points.smooth:
                text += "; velocities from its positions"
            if schedule.blend_error > 0.0:
                text += f"; its ramps pass the points in between at up to {schedule.blend_error:.3g} rad"
        source = OF_ACTION if request.is_goal else ""
        start_ns = start * rates.period_ns * rates.ratio
        self._reports.append(partial(self._log.accepted, request.message, start_ns, source))
        self.note(text)

    def _deliver_event(self, event: Event | None, *, wanted: bool = False) -> None:
        if event is not None:
            sender: Any = event.key
            self._deliver(event.outcome, sender, wanted=wanted)

    def _deliver(self, outcome: Outcome, sender: Sender, *, wanted: bool = False) -> None:
        self.post(partial(sender.on_result, outcome))
        text = one_line(f"goal {outcome.phase.value}: {outcome.text}")
        self.note(text, wrong=outcome.phase is Phase.ABORTED and not wanted)


def _kind(request: TrajectoryRequest) -> str:
    return "goal" if request.is_goal else "trajectory"


def _replaced(request: TrajectoryRequest) -> str:
    """Return why what ran before has ended."""
    return "pre-empted by a new goal" if request.is_goal else "replaced by a trajectory on the topic"
