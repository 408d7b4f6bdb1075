"""The queue of requests, from the topic and from the action, on the controller's ticks, and what is said of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import one_line
from rx90_common.exchange.topics import OF_ACTION
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory.generator import PastError, Schedule, points_left
from rx90_controller.trajectory.request import (
    GoalError,
    GoalOptions,
    GoalTolerances,
    JoinedAhead,
    ResultCode,
    State,
    TrajectoryRequest,
    check_request,
)


class Outputs(Protocol):
    """Where set-points, tracking errors, accepted trajectories and lines for the user go.

    Attributes:
        ready: the line that says that the first states have come.
    """

    ready: str

    def wait_for_subscribers(self) -> None:
        """Wait, not without end, until those who listen will get the first message."""

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left."""

    def wake(self) -> None:
        """Have `Requests.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int, source: str = "") -> None:
        """Publish a trajectory that is followed, when it starts, ns, and OF_ACTION for one that was a goal."""

    def info(self, text: str) -> None:
        """Print what happened."""

    def error(self, text: str) -> None:
        """Print what went wrong."""


class Requests:
    """Lets the set-point generator follow requests, one at a time, and notes what is to be said until `report` says it.

    To print may take longer than a tick: the thread that ticks only notes. All but `report`, `post` and `checked` is
    called between ticks. A request that is followed takes the place of the one before; one that is refused leaves that
    alone. One that succeeds leaves the arm at its last point; whatever else ends one leaves the set-points as they are,
    but for a cancel and a violated tolerance, where the arm stops along the path.

    Args:
        cs7b: whose generator follows them.
        outputs: get what became of them.
        horizon: how far ahead of the controller's time, s, one may start.
        monitor_ticks: position ticks from one feedback to the next.

    Attributes:
        options: what else is accepted; may be changed for the next ones.
        tolerances: of goals that have none of their own, and of trajectories; may be changed for the next ones.
        rejected: number of requests that were refused.
        last_rejection: which was the last of them, when and why; empty before the first.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int) -> None:
        self._cs7b, self._outputs, self._horizon, self._monitor_ticks = cs7b, outputs, horizon, monitor_ticks
        self.options, self.tolerances = GoalOptions(), GoalTolerances.of_parameters(cs7b.joint_names)
        self._waiting: TrajectoryRequest | None = None  # for the first states
        self._active: TrajectoryRequest | None = None  # a goal, or a trajectory that is held to tolerances
        self._velocity, self._tick = np.zeros(6), -1  # of the last step, for the acceleration
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
        self._outputs.wake()

    def note(self, text: str, *, wrong: bool = False) -> None:
        """Note a line."""
        self.post(partial(self._outputs.error if wrong else self._outputs.info, text))

    def note_dropped(self, why: str) -> None:
        """Note that a trajectory comes to no end, if one runs or waits for its start."""
        now = self._cs7b.position_tick
        if self._cs7b.trajectory.moving(now):
            self.note(f"trajectory dropped at {now * self._cs7b.rates.position_period:.3f} s: {why}")

    def note_end(self) -> None:
        """Note the end of a trajectory, if it is in this tick of the position loop."""
        end = self._cs7b.trajectory.ended(self._cs7b.position_tick)
        if end is not None:
            what = "stopped" if end.stop else "trajectory ended"
            self.note(f"{what} at {end.tick * self._cs7b.rates.position_period:.3f} s; holding")

    def refused(self, kind: str, error: TrajectoryError, *, quiet: bool = False) -> None:
        """Count a goal or a trajectory that was refused, and note why, unless its result says so."""
        self.rejected += 1
        self.last_rejection = f"{kind} at {self._cs7b.position_tick * self._cs7b.rates.position_period:.3f} s: {error}"
        if not quiet:
            self.note(f"{kind} rejected: {error}", wrong=True)

    # Requests, from the executor's thread.

    def checked(self, message: Any, goal: Any = None) -> TrajectoryRequest:
        """Return a trajectory, of the topic or of a goal, checked by itself; may take long, so not between ticks.

        Raises:
            GoalError: naming joint, index of the point and reason.
        """
        return check_request(message, self.tolerances, self.options, self._cs7b.rates.position_hz, goal)

    def check_goal(self, goal: TrajectoryRequest, inactive: str) -> None:
        """Check whether a goal may be accepted, wherever the arm is.

        Raises:
            GoalError: if the controller is not active, for this reason, or if the goal's last point is over.
        """
        if inactive:
            raise GoalError(ResultCode.INVALID_GOAL, inactive)
        assert goal.points is not None
        try:
            points_left(goal.points, self._cs7b.position_tick, goal.start, self._cs7b.trajectory.period)
        except PastError as error:
            raise GoalError(ResultCode.OLD_HEADER_TIMESTAMP, str(error)) from error

    def wait(self, request: TrajectoryRequest) -> None:
        """Keep a request for the first states."""
        replaces = self._waiting is not None and not self._waiting.is_goal
        self.drop(_reason_replaced(request), wanted=True)
        self._waiting, request.state = request, State.WAITING
        instead = ", in place of the one that waited" if replaces else ""
        self.note(f"a {request.kind} waits for the simulation's first tick{instead}")

    def joined_ahead(self, request: TrajectoryRequest, attempt: int) -> JoinedAhead:
        """Return the request to be joined beside the ticks."""
        return JoinedAhead(request, self._cs7b.trajectory, self._cs7b.position_tick, attempt)

    def fits(self, joined: JoinedAhead) -> bool:
        """Return whether a request that was joined beside the ticks can be followed, or refused, in this tick."""
        return joined.fits(self._cs7b.position_tick)

    def follow(self, request: TrajectoryRequest, inactive: str, joined: JoinedAhead | None = None) -> None:
        """Follow a request in place of what runs, or refuse it and let that go on.

        Args:
            request: checked.
            inactive: why nothing can be followed now, and what is accepted; empty if something can.
            joined: the same, joined beside the ticks, if that takes long.
        """
        now, trajectory = self._cs7b.position_tick, self._cs7b.trajectory
        try:
            if inactive:
                raise TrajectoryError(inactive)
            if request.start is not None and (request.start - now) * trajectory.period > self._horizon:
                raise TrajectoryError(
                    f"start time {request.start * trajectory.period:.3f} s, the controller's time is "
                    f"{now * trajectory.period:.3f} s; accepted: 0 for now, or simulated time within {self._horizon:g} "
                    "s"
                )
            schedule = request.enter(trajectory, now) if joined is None else joined.adopt(now)
        except TrajectoryError as error:
            self.refused(request.kind, error, quiet=request.is_goal)
            past = isinstance(error, PastError)
            code = ResultCode.OLD_HEADER_TIMESTAMP if past else ResultCode.INVALID_GOAL
            self._end(request, State.ABORTED, code, str(error))
            return
        self._drop_active(_reason_replaced(request), wanted=True)
        request.state = State.WAITING if request.is_goal else State.FOLLOWED
        if request.is_goal or request.tolerances.end_motions:
            # What runs until a trajectory of the topic starts is held to its tolerances, too.
            self._active = request
        self._announce(request, schedule)

    def cancel(self, request: TrajectoryRequest) -> None:
        """Cancel a goal: the arm stops along the path. One that has ended meanwhile keeps its end."""
        if self._waiting is request:
            self._waiting, text = None, "cancelled before the simulation's first tick"
        elif self._active is request:
            period = self._cs7b.trajectory.period
            schedule = self._cs7b.trajectory.halt(self._cs7b.position_tick)
            begin, end = schedule.begin * period, schedule.end * period
            self._active, text = None, f"cancelled; stopping from {begin:.6g} s on, at rest at {end:.6g} s"
        else:
            return
        self._end(request, State.CANCELED, ResultCode.SUCCESSFUL, text)

    # The ticking thread.

    def begin(self, inactive: str) -> None:
        """Follow what has waited for the first states."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self.follow(waiting, inactive)

    def step(self) -> None:
        """Hold the active request, if there is one, to its tolerances, after a tick of the position loop."""
        request, cs7b = self._active, self._cs7b
        if request is None:
            return
        tick, trajectory, desired = cs7b.position_tick - 1, cs7b.trajectory, cs7b.setpoint.copy()
        position, velocity = cs7b.measured()
        acceleration = (velocity - self._velocity) / trajectory.period if tick == self._tick + 1 else desired[2]
        self._velocity, self._tick = velocity, tick
        outcome = request.step(tick, desired, np.stack([position, velocity, acceleration]), trajectory)
        if outcome is not None:
            self._active = None
            if outcome.state is State.ABORTED:
                trajectory.halt(tick + 1)
            self._deliver(request)
        elif request.client is not None and request.feedback is not None and tick % self._monitor_ticks == 0:
            self.post(partial(request.client.on_feedback, request.feedback))

    # Either thread.

    @property
    def pending(self) -> bool:
        """Return whether a goal is active, or waits for the first states."""
        return any(request is not None and request.is_goal for request in (self._active, self._waiting))

    def drop(self, reason: str, *, halt: bool = False, wanted: bool = False) -> None:
        """End the goal, if there is one, with -1 and a reason: `halt` on its path; `wanted`, so nothing went wrong."""
        waiting, goal = self._waiting, self._active is not None and self._active.is_goal
        if waiting is not None and waiting.is_goal:
            self._waiting = None
            self._end(waiting, State.ABORTED, ResultCode.INVALID_GOAL, reason, wanted=wanted)
        self._drop_active(reason, wanted=wanted)
        if halt and goal:
            self._cs7b.trajectory.halt(self._cs7b.position_tick)

    def _drop_active(self, reason: str, *, wanted: bool) -> None:
        request, self._active = self._active, None
        if request is not None and request.is_goal:
            text = f"{reason}, at {self._cs7b.position_tick * self._cs7b.trajectory.period:.6g} s"
            self._end(request, State.ABORTED, ResultCode.INVALID_GOAL, text, wanted=wanted)

    def _end(
        self, request: TrajectoryRequest, state: State, code: ResultCode, text: str, *, wanted: bool = False
    ) -> None:
        request.end(state, code, text, self._cs7b.position_tick)
        if request.is_goal:
            self._deliver(request, wanted=wanted)

    def _deliver(self, request: TrajectoryRequest, *, wanted: bool = False) -> None:
        """Have the client of a goal hear how it has ended, and note it."""
        outcome = request.outcome
        assert outcome is not None
        aborted = outcome.state is State.ABORTED
        if request.client is not None:
            self.post(partial(request.client.on_result, outcome))
            self.note(one_line(f"goal {outcome.state.value}: {outcome.text}"), wrong=aborted and not wanted)
        elif aborted:
            self.note(f"trajectory aborted: {outcome.text}; stopping and holding", wrong=True)

    def _announce(self, request: TrajectoryRequest, schedule: Schedule) -> None:
        """Note what is followed, and publish it with its start."""
        rates, points = self._cs7b.rates, request.points
        begin, end = (tick * rates.position_period for tick in (schedule.begin, schedule.end))
        start = schedule.begin if request.start is None else request.start
        if points is None:
            start = schedule.begin
            text = f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s"
        else:
            text = f"{request.kind} accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin:.3f} s"
            if points.smooth:
                text += "; velocities from its positions"
            if schedule.blend_error > 0.0:
                text += f"; its ramps pass the points in between at up to {schedule.blend_error:.3g} rad"
        source = OF_ACTION if request.is_goal else ""
        start_ns = start * rates.period_ns * rates.ratio
        self._reports.append(partial(self._outputs.accepted, request.message, start_ns, source))
        self.note(text)


def _reason_replaced(request: TrajectoryRequest) -> str:
    """Return why what ran before a request has ended."""
    return "pre-empted by a new goal" if request.is_goal else "replaced by a trajectory on the topic"
