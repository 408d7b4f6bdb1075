"""Goals of the action on the controller's ticks: taken, watched, cancelled, dropped; who sent one is told by events."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import one_line
from rx90_common.exchange.topics import OF_ACTION
from rx90_controller.goals.execution import Feedback, Outcome, Phase
from rx90_controller.goals.goal import Goal, GoalOptions
from rx90_controller.goals.results import GoalError, ResultCode
from rx90_controller.goals.runner import Event, GoalRunner
from rx90_controller.goals.tolerances import GoalTolerances
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.requests import Requests
from rx90_controller.trajectory.planning import Entrance, Plan


class Sender(Protocol):
    """Who sent a goal; called by the executor's thread, in the order of what has happened."""

    def went(self, feedback: Feedback) -> None:
        """Hear how the goal goes."""

    def ended(self, outcome: Outcome) -> None:
        """Hear how it has ended; the last call."""


class _Waiting(NamedTuple):
    """A goal that waits for the first states."""

    sender: Sender
    goal: Goal
    trajectory: Any


class GoalRequests:
    """Runs the goals of the action; all calls come between ticks.

    Args:
        cs7b: whose generator follows them.
        requests: what is said goes through it; its options say what else is accepted.
        horizon: how far ahead of the controller's time, s, a goal may start.
        monitor_ticks: position ticks from one feedback to the next.

    Attributes:
        tolerances: of goals that have none of their own, and of trajectories on the topic; may be changed for the next.
    """

    def __init__(self, cs7b: CS7B, requests: Requests, horizon: float, monitor_ticks: int) -> None:
        self._cs7b, self._requests, self._monitor_ticks = cs7b, requests, monitor_ticks
        self._runner = GoalRunner(cs7b.trajectory, requests.options, horizon)
        self.tolerances = GoalTolerances.defaults(cs7b.joint_names)
        self._waiting: _Waiting | None = None

    # The ticking thread.

    def step(self) -> None:
        """Watch the active goal or trajectory, if there is one, after a tick of the position loop."""
        runner = self._runner
        if not runner.watching:
            return
        cs7b = self._cs7b
        tick = cs7b.position_tick - 1
        sender = cast(Sender | None, runner.active)
        event = runner.step(tick, cs7b.setpoint, *cs7b.measured())
        if sender is None:
            if event is not None and event.outcome.phase is Phase.ABORTED:
                self._requests.note(f"trajectory aborted: {event.outcome.text}; stopping and holding", wrong=True)
        elif event is not None:
            self._tell(event.outcome, sender)
        elif tick % self._monitor_ticks == 0 and runner.feedback is not None:
            self._requests.post(partial(sender.went, runner.feedback))

    def begin(self, inactive: str) -> None:
        """Take the goal that has waited for the first states, if there is one."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self.take(*waiting, inactive)

    # Either thread.

    def watch(self) -> None:
        """Hold a trajectory of the topic that was just taken to the tolerances, as a goal is."""
        self._runner.watch(self.tolerances)

    @property
    def pending(self) -> bool:
        """Return whether a goal is active, or waits for the first states."""
        return self._runner.active is not None or self._waiting is not None

    def drop(self, reason: str, *, halt: bool = False, wanted: bool = False) -> None:
        """End the goal, if there is one, with -1 and a reason: `halt` on its path; `wanted`, so nothing went wrong."""
        now = self._cs7b.position_tick
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            self._tell(Outcome(Phase.ABORTED, ResultCode.INVALID_GOAL, reason, now), waiting.sender, wanted=wanted)
        sender = self._runner.active
        self._deliver(self._runner.drop(reason, now), wanted=wanted)
        if halt and sender is not None:
            self._cs7b.trajectory.halt(now)

    # The executor's thread.

    @property
    def options(self) -> GoalOptions:
        """Return what else is accepted of trajectories and goals; may be changed for the next ones."""
        return self._requests.options

    @options.setter
    def options(self, options: GoalOptions) -> None:
        self._requests.options = self._runner.options = options

    def refuse(self, error: GoalError) -> None:
        """Count and note a goal that was refused."""
        self._requests.refused("goal", error)

    def check(self, goal: Goal, inactive: str) -> None:
        """Check whether a goal may be taken, wherever the arm is.

        Raises:
            GoalError: if the controller is not active, for this reason, or if the goal's last point is over.
        """
        if inactive:
            raise GoalError(ResultCode.INVALID_GOAL, inactive)
        self._runner.check_future(goal, self._cs7b.position_tick)

    def wait(self, sender: Sender, goal: Goal, trajectory: Any) -> None:
        """Take a goal as soon as there are states."""
        self.drop("pre-empted by a new goal", wanted=True)
        self._waiting = _Waiting(sender, goal, trajectory)
        self._requests.note("a goal waits for the simulation's first tick")

    def plan(self, entrance: Entrance, attempt: int) -> Plan:
        """Return what a trajectory is to be joined to beside the ticks; each attempt, from 0 on, has more time."""
        lead = entrance.lead(self._cs7b.rates.position_period) * 4**attempt
        return Plan(self._cs7b.trajectory, entrance, self._cs7b.position_tick, lead)

    def fits(self, plan: Plan) -> bool:
        """Return whether a plan can be adopted, or tells why not, in this tick."""
        return plan.fits(self._cs7b.position_tick)

    def take(self, sender: Sender, goal: Goal, trajectory: Any, inactive: str, plan: Plan | None = None) -> None:
        """Follow a goal in place of the one before, or abort it and let that one go on.

        Args:
            sender: hears of it.
            goal: checked.
            trajectory: of the goal, as it came.
            inactive: see `ServoLoop.inactive`.
            plan: to which the goal was joined, if it takes long.
        """
        now = self._cs7b.position_tick
        try:
            schedule, ended = self._runner.offer(sender, goal, now, inactive, plan)
        except GoalError as error:
            self._requests.count_refused("goal", error)
            self._tell(Outcome(Phase.ABORTED, error.code, str(error), now), sender)
            return
        self._deliver(ended, wanted=True)
        self._requests.announce("goal", trajectory, goal.points, schedule, goal.start, OF_ACTION)

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
            self._tell(Outcome(Phase.CANCELED, ResultCode.SUCCESSFUL, text, now), sender)
        elif self._runner.active is sender:
            self._deliver(self._runner.cancel(now))

    def _deliver(self, event: Event | None, *, wanted: bool = False) -> None:
        if event is not None:
            self._tell(event.outcome, cast(Sender, event.key), wanted=wanted)

    def _tell(self, outcome: Outcome, sender: Sender, *, wanted: bool = False) -> None:
        self._requests.post(partial(sender.ended, outcome))
        text = one_line(f"goal {outcome.phase.value}: {outcome.text}")
        self._requests.note(text, wrong=outcome.phase is Phase.ABORTED and not wanted)
