"""The CS7B in operation: it holds the arm, follows requests one at a time and can be switched off; needs no ROS.

Requests arrive by topic or as goals of the action, in one queue for all senders. An accepted one replaces the
running one; a refused one has no effect on it. One that succeeds leaves the arm at its last point; any other end
leaves the set-points as they are, except that a cancel or a violated tolerance stops the arm along the
path. Printing may take longer than a tick: the ticking thread only stores the messages.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import counted, one_line
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.pacing import ThrottledLog
from rx90_common.exchange.topics import CORRECTED, OF_ACTION
from rx90_controller.law.cs7b import CS7B, DriveFault
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.generator import PastError, points_left
from rx90_controller.trajectory.points import correction_from_points, points_from_message, trajectory_identity
from rx90_controller.trajectory.request import (
    GoalOptions,
    GoalTolerances,
    JoinedAhead,
    ResultCode,
    State,
    TrajectoryRequest,
    check_request,
)
from rx90_controller.trajectory.stream import LONGEST_PAUSE, SetPoints, Stream, StreamOptions, from_trajectory

INACTIVE: Final = "the controller is inactive; accepted: in state active"
_ATTEMPTS = 3  # to join a long trajectory outside the ticks, each with more time than the one before


class MotorStates(NamedTuple):
    """The motor states of one tick; the arrays are valid until the next ones have been decoded.

    Attributes:
        stamp_ns: sample time, ns.
        position: rad, shape (n,).
        velocity: rad/s, shape (n,).
        torque: reported by the drives, Nm, shape (n,), if it is.
    """

    stamp_ns: int
    position: Array
    velocity: Array
    torque: Array | None = None


class Outputs(Protocol):
    """Receives set-points, tracking errors, accepted trajectories and lines for the user.

    Attributes:
        ready: the line for the log once the first states have arrived.
    """

    ready: str

    def wait_for_subscribers(self) -> None:
        """Wait, not without end, until those who listen will get the first message."""

    def publish(self, stamp_ns: int) -> None:
        """Publish the results of the position loop."""

    def wake(self) -> None:
        """Have `ServoLoop.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int, source: str) -> None:
        """Publish a trajectory that is followed, when it starts, ns, and OF_ACTION for one that was a goal."""

    def info(self, text: str) -> None:
        """Print an event."""

    def error(self, text: str) -> None:
        """Print a problem."""


class ServoLoop:
    """Runs the CS7B tick by tick; requests and switches may come from another thread, between ticks.

    Args:
        cs7b: the control law, warmed up.
        outputs: receive set-points and errors, and the results of requests.
        horizon: how far ahead of its own time, s, a request may start.
        monitor_ticks: position ticks from one feedback of a goal to the next.

    Attributes:
        between_ticks: lock that keeps ticks from running; its holder may call no method of this class.
        command: see `CS7B`.
        active, enabled: whether the node is active, and whether the motors get torque.
        fault: the reason why the supervision has cut the power, until it is switched on again.
        running: whether states have been received.
        options: permitted exceptions from the checks; may be changed for the next requests.
        tolerances: of trajectories, and of goals without tolerances of their own; may be changed for the next ones.
        streaming: how streamed set-points are joined.
        rejected: number of requests, and set-points of streams, that were refused.
        last_rejection: the last of them, with time and reason; empty before the first.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int = 50) -> None:
        self._cs7b = cs7b
        self._outputs = outputs
        self._horizon = horizon
        self._monitor_ticks = monitor_ticks
        self._period = cs7b.rates.position_period
        self.between_ticks = threading.Lock()
        self.command = cs7b.command
        self.active = self.enabled = True
        self.fault: DriveFault | None = None
        self._released = False  # switched off since the last tick: also if it is on again by now, the motion is over
        self._law_changes: deque[tuple[np.ndarray[Any, Any], Callable[[int], None]]] = deque()
        self.running = self._unpublished = False  # whether the position loop has left something
        self.options = GoalOptions()
        self.tolerances = GoalTolerances.of_parameters(cs7b.joint_names)
        self._waiting: TrajectoryRequest | None = None  # for the first states, or those after the torque was off
        self._correction: tuple[str, Correction] | None = None  # for the trajectory of that identity
        self._followed: TrajectoryRequest | None = None  # a goal, or a trajectory that is held to tolerances
        self.streaming = StreamOptions()
        self._stream: Stream | None = None  # that is followed
        self._silent_since = -math.inf  # s, when the last set-point of a stream came that nothing but silence ended
        self._complaints = ThrottledLog(partial(self._note, wrong=True))  # of set-points, which come by the hundred
        # measured last while something was followed
        self._velocity = np.zeros(len(cs7b.joint_names))
        self._tick = -1
        self.rejected = 0
        self.last_rejection = ""
        self._reports: deque[Callable[[], None]] = deque()

    # The ticking thread.

    def begin(self) -> None:
        """Wait for the subscribers."""
        self._outputs.wait_for_subscribers()

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is; a request that waited for the first states begins."""
        with self.between_ticks:
            if self.running:
                reason = f"the states go on from {states.stamp_ns / NANOSECONDS:.6g} s; holding"
                self._note_dropped(reason)
                self._drop_waiting(reason)
                self._drop(reason)
            else:
                self._note(self._outputs.ready)
            self._cs7b.reset(states.position, states.stamp_ns // self._cs7b.rates.period_ns)
            self.running = True
            self._released = False
            self._follow_waiting()

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the loops that are due; return whether the motors get torque."""
        cs7b = self._cs7b
        with self.between_ticks:
            slow = cs7b.on_position_tick
            while self._law_changes and slow:
                cs7b.law[:], effective = self._law_changes.popleft()
                self._post(partial(effective, stamp_ns))
            if self._released or not self.enabled:
                self._released = False
                self._note_dropped("the torque is off")
                cs7b.release(states.position, stamp_ns // cs7b.rates.period_ns + 1)
                if self.enabled:
                    self._follow_waiting()
                return False
            if slow:
                end = cs7b.trajectory.ended(cs7b.position_tick)
                if end is not None:
                    what = "stopped" if end[1] else "trajectory ended"
                    self._note(f"{what} at {end[0] * self._period:.3f} s; holding")
                stream = self._stream
                tick = cs7b.position_tick
                if stream is not None and tick * self._period > stream.expires and not cs7b.trajectory.moving(tick):
                    self._end_stream("holding")
                    self._silent_since = stream.expires - self.streaming.timeout
            cs7b.step(states.position, states.velocity, states.torque)
            self._unpublished = slow
            fault = cs7b.fault
            if fault is None:
                return True
            if fault.quantity == "torque":
                self._unpublished = False  # torques that are no numbers
            self._publish(stamp_ns)  # before the reset: the values that led to the fault must be visible
            self.enabled = False
            self.fault = fault
            text = f"{fault}; torque off, brakes closed, trajectory dropped, until ~/enable is called with true"
            self._note(text, wrong=True)
            self._drop(f"{fault}; torque off, brakes closed")
            cs7b.release(states.position, cs7b.tick)
            return False

    def after_command(self, stamp_ns: int) -> None:
        """Publish the results of the last step: after its command, for which the simulation waits."""
        with self.between_ticks:
            self._publish(stamp_ns)

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points: a running trajectory comes later."""
        with self.between_ticks:
            self._cs7b.skip(count)

    def _publish(self, stamp_ns: int) -> None:
        if self._unpublished:
            self._unpublished = False
            if self._followed is not None:
                self._watch(self._followed)
            self._outputs.publish(stamp_ns)

    def _watch(self, request: TrajectoryRequest) -> None:
        """Hold a request to its tolerances, after a tick of the position loop."""
        cs7b = self._cs7b
        trajectory = self._cs7b.trajectory
        tick = cs7b.position_tick - 1
        desired = cs7b.setpoint.copy()
        (position, velocity) = cs7b.measured()
        acceleration = (velocity - self._velocity) / trajectory.period if tick == self._tick + 1 else desired[2]
        self._velocity = velocity
        self._tick = tick
        request.step(tick, desired, np.stack([position, velocity, acceleration]), trajectory)
        if request.reason:
            self._followed = None
            if request.state is State.ABORTED:
                trajectory.halt(tick + 1)
            self._deliver(request)
        elif request.on_feedback is not None and request.feedback is not None and tick % self._monitor_ticks == 0:
            self._post(partial(request.on_feedback, request.feedback))

    # Switches, from any thread.

    def enable(self, on: bool, why: str = "the torque is off") -> None:
        """Switch the torque on or off; off, the brakes hold the arm, and the goal ends with `why`."""
        with self.between_ticks:
            self.enabled = on
            if on:
                self.fault = None
            else:
                self._released = True
                if self.running:
                    self._drop_waiting(why)
                self._drop(why)

    def activate(self, on: bool) -> None:
        """Follow the node into its state active, where the torque is on, or out of it."""
        self.active = on
        self.enable(on, "the controller is deactivated, the torque is off")

    def change_law(self, law: np.ndarray[Any, Any], effective: Callable[[int], None]) -> None:
        """Let other constants of the law, shape (1,), CONTROLLER_DTYPE, count from the next position tick on.

        Before it the velocity loop would have gains that do not belong to the torque of the position loop. Integrators,
        which hold torques, go on as they are. `effective` is then called, by `report`, with the time of that tick, ns.
        """
        self._law_changes.append((law, effective))

    @property
    def inactive(self) -> str:
        """Return why no trajectory can be followed now, and the condition for it; empty if one can."""
        if not self.active:
            return INACTIVE
        if self.fault is not None:
            return f"{self.fault}; torque off; accepted: after a call of ~/enable with true"
        if not self.enabled:
            return "the controller is disabled; accepted: after a call of ~/enable with true"
        return ""

    # Requests, from the executor's thread.

    def receive(self, message: Any, goal: Any = None, missing: str = "") -> TrajectoryRequest | None:
        """Return a trajectory, checked by itself; None if it is refused, which is logged, or if it is of a stream.

        Long computations are not done between ticks. A trajectory of the topic is followed at once; a goal is left to
        `offer`, and must have points in the future.

        Args:
            message: trajectory_msgs/JointTrajectory; of the topic, one without points is a stop.
            goal: the goal of FollowJointTrajectory that contains it.
            missing: a further reason why no goal can be followed now, besides `inactive`.
        """
        kind = "trajectory" if goal is None else "goal"
        if goal is None and self._is_streamed(message):
            self.receive_stream(partial(self._streamed, message), "the trajectory topic")
            return None
        try:
            request = check_request(message, self.tolerances, self.options, self._cs7b.rates.position_hz, goal)
            self._correct(request)
            with self.between_ticks:
                if (self.running or goal is not None) and (self.inactive or missing):
                    raise TrajectoryError(self.inactive or missing)
                if goal is not None:
                    assert request.points is not None
                    points_left(request.points, self._cs7b.position_tick, request.start, self._period)
        except TrajectoryError as error:
            with self.between_ticks:
                self._refused(kind, error)
            return None
        if request.remark:
            with self.between_ticks:
                self._note(f"{kind}: {request.remark}", wrong=True)
        if goal is None:
            self.offer(request)
        return request

    def receive_correction(self, message: Any) -> None:
        """Keep offsets for the trajectory whose identity is in their frame, until it arrives, or another correction.

        Args:
            message: trajectory_msgs/JointTrajectory: a point with positions, the offsets in rad, for each set-point.
        """
        try:
            points = points_from_message(self._cs7b.joint_names, message)
            correction = correction_from_points(points, self._period)
        except TrajectoryError as error:
            self._correction = None
            with self.between_ticks:
                self._refused("correction", error)
            return
        self._correction = message.header.frame_id, correction

    def _correct(self, request: TrajectoryRequest) -> None:
        """Join a request with the correction that waits for it.

        Raises:
            TrajectoryError: if it is not to run without one, and none waits for it.
        """
        requested = request.message.header.frame_id == CORRECTED
        points = request.points
        if points is None or (self._correction is None and not requested):
            return
        identity = trajectory_identity(points)
        waiting = self._correction
        self._correction = None
        if waiting is not None and waiting[0] == identity:
            request.points = replace(points, correction=waiting[1])
        elif requested:
            raise TrajectoryError("its correction has not come; accepted: after it on ~/commanded_correction")
        else:
            with self.between_ticks:
                self._note("the correction that waited belongs to another trajectory; dropped")

    def offer(self, request: TrajectoryRequest) -> None:
        """Follow a request, at the latest once there are states, or refuse it.

        A long one is joined to the motion outside the ticks; if the motion changes meanwhile, or the time was too
        short, again with more time. A short one, and one that never was in time, is joined between two ticks.
        """
        for attempt in range(_ATTEMPTS if request.long else 0):
            with self.between_ticks:
                if not self.running or self._released or self.inactive:
                    break
                joined = JoinedAhead(request, self._cs7b.trajectory, self._cs7b.position_tick, attempt)
            joined.compute()
            with self.between_ticks:
                # Switched off meanwhile, and on again: the next tick releases the arm, and whatever moves it then.
                if not self._released and joined.fits(self._cs7b.position_tick):
                    self._follow(request, joined)
                    return
        with self.between_ticks:
            if self.running and (self.inactive or not self._released):
                self._follow(request)
                return
            replaces = self._waiting is not None and not self._waiting.is_goal
            self._drop(_reason_replaced(request), wanted=True)
            self._waiting = request
            request.state = State.WAITING
            instead = ", in place of the one that waited" if replaces else ""
            tick = "next tick, with which the torque comes back" if self.running else "simulation's first tick"
            self._note(f"a {request.kind} waits for the {tick}{instead}")

    def receive_stream(self, read: Callable[[], SetPoints], source: str) -> None:
        """Follow set-points of a stream in place of the running motion, or refuse them, which is logged now and then.

        Args:
            read: returns them, or raises TrajectoryError.
            source: name of the source, in words.
        """
        try:
            points = read()
            with self.between_ticks:
                if reason := self.inactive:
                    raise TrajectoryError(reason)
                if self._released or not self.running:
                    missing = "the torque comes back with the next tick" if self.running else "no states have come yet"
                    raise TrajectoryError(f"{missing}; accepted: from then on")
                self._follow_stream(points, source)
        except TrajectoryError as error:
            with self.between_ticks:
                self._refused("set-point", error, quiet=True)
                self._complaints.say(source, f"set-point from {source} ignored: {error}")

    def _is_streamed(self, message: Any) -> bool:
        """Return whether a trajectory of the topic is a set-point of a stream: its end is as near as that of one."""
        if not self.running or not len(message.points):
            return False
        start = message_time_ns(message.header.stamp) / NANOSECONDS
        end = message_time_ns(message.points[-1].time_from_start) / NANOSECONDS
        ahead = end + (start - self._cs7b.position_tick * self._period if start else 0.0)
        least = -self.streaming.window if self._stream is not None else 0.0
        return end > 0.0 and least < ahead <= self.streaming.window

    def _streamed(self, message: Any) -> SetPoints:
        partial_joints = self.options.allow_partial_joints_goal
        names = self._cs7b.joint_names
        points = points_from_message(names, message, partial=partial_joints, moving_end=True)
        return from_trajectory(points, message_time_ns(message.header.stamp))

    @property
    def stream(self) -> str:
        """Return the streamed quantity, in words; empty without a stream."""
        stream = self._stream
        return "" if stream is None else f"{stream.interface}, {counted(stream.count, 'set-point')}, {stream.late} late"

    @property
    def has_goal(self) -> bool:
        """Return whether a goal is followed, or waits for the first states."""
        return any(request is not None and request.is_goal for request in (self._followed, self._waiting))

    def cancel(self, request: TrajectoryRequest) -> None:
        """Cancel a goal: the arm stops along the path. One that has ended meanwhile keeps its end."""
        with self.between_ticks:
            if self._waiting is request:
                self._waiting = None
                text = "cancelled before it began"
            elif self._followed is request:
                schedule = self._cs7b.trajectory.halt(self._cs7b.position_tick)
                begin = schedule.begin * self._period
                end = schedule.end * self._period
                self._followed = None
                text = f"cancelled; stopping from {begin:.6g} s on, at rest at {end:.6g} s"
            else:
                return
            request.end(State.CANCELED, ResultCode.SUCCESSFUL, text)
            self._deliver(request)

    def drop(self, reason: str, *, halt: bool = False) -> None:
        """End the goal, if there is one, with -1 and a reason: `halt` on its path."""
        with self.between_ticks:
            goal = self._followed is not None and self._followed.is_goal
            self._drop(reason)
            if halt and goal:
                self._cs7b.trajectory.halt(self._cs7b.position_tick)

    def report(self) -> None:
        """Print and publish the stored messages; called after each `Outputs.wake`."""
        while self._reports:
            self._reports.popleft()()

    # Between ticks.

    def _drop_waiting(self, why: str) -> None:
        if self._waiting is not None and not self._waiting.is_goal:
            self._waiting = None
            self._note(f"the trajectory that waited is dropped: {why}")

    def _follow_waiting(self) -> None:
        waiting = self._waiting
        self._waiting = None
        if waiting is not None:
            self._follow(waiting)

    def _follow(self, request: TrajectoryRequest, joined: JoinedAhead | None = None) -> None:
        """Follow a request, perhaps joined already, in place of the running motion, or refuse it without effect."""
        now = self._cs7b.position_tick
        trajectory = self._cs7b.trajectory
        period = self._period
        points = request.points
        try:
            if self.inactive:
                raise TrajectoryError(self.inactive)
            if request.start is not None and (request.start - now) * period > self._horizon:
                raise TrajectoryError(
                    f"start time {request.start * period:.3f} s, the controller's time is {now * period:.3f} s; "
                    f"accepted: 0 for now, or simulated time within {self._horizon:g} s"
                )
            schedule = request.enter(trajectory, now) if joined is None else joined.adopt(now)
        except TrajectoryError as error:
            self._refused(request.kind, error, quiet=request.is_goal)
            past = isinstance(error, PastError)
            request.end(State.ABORTED, ResultCode.OLD_HEADER_TIMESTAMP if past else ResultCode.INVALID_GOAL, str(error))
            if request.is_goal:
                self._deliver(request)
            return
        self._drop(_reason_replaced(request), wanted=True)
        request.state = State.WAITING if request.is_goal else State.FOLLOWED
        if request.is_goal or request.tolerances.end_motions:
            # What runs until a trajectory of the topic starts is held to its tolerances, too.
            self._followed = request
        begin = schedule.begin * period
        end = schedule.end * period
        if points is None:
            text = f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s"
        else:
            count = counted(len(points.times), "point")
            text = f"{request.kind} accepted: {count}, {points.times[-1]:.3f} s from {begin:.3f} s"
            if points.smooth:
                text += "; velocities from its positions"
            if points.correction is not None:
                text += "; with its correction"
            if schedule.blend_error > 0.0:
                text += f"; its ramps pass the points in between at up to {schedule.blend_error:.3g} rad"
        start = schedule.begin if request.start is None or points is None else request.start
        start_ns = start * self._cs7b.rates.period_ns * self._cs7b.rates.ratio
        source = OF_ACTION if request.is_goal else ""
        self._reports.append(partial(self._outputs.accepted, request.message, start_ns, source))
        self._note(text)

    def _follow_stream(self, points: SetPoints, source: str) -> None:
        cs7b = self._cs7b
        stream = self._stream
        now = cs7b.position_tick
        if stream is None or stream.interface != points.interface or (stream.named != points.named).any():
            stream = Stream(points.interface, points.named, cs7b.trajectory.limits, self._period, self.streaming)
            pause = now * self._period - self._silent_since
            stream.pause = pause if pause <= LONGEST_PAUSE else 0.0
        told = len(stream.notes)
        cs7b.trajectory.follow_stream(stream, points, now)
        if stream is not self._stream:
            self._drop("replaced by streamed set-points", wanted=True)
            self._stream = stream
            self._note(f"stream begins at {now * self._period:.3f} s: {points.interface} set-points from {source}")
        for text in list(stream.notes.values())[told:]:
            self._note(f"stream: {text}", wrong=True)

    def _end_stream(self, what: str) -> None:
        stream = self._stream
        self._stream = None
        self._silent_since = -math.inf
        if stream is not None:
            late = f", {stream.late} of them late" if stream.late else ""
            now = self._cs7b.position_tick * self._period
            self._note(f"stream ended at {now:.3f} s after {counted(stream.count, 'set-point')}{late}; {what}")

    def _drop(self, reason: str, *, wanted: bool = False) -> None:
        """End the stream, and the goal, if there is one, with -1 and a reason; `wanted`: the end is no failure."""
        self._end_stream(reason)
        when = f", at {self._cs7b.position_tick * self._period:.6g} s"
        waiting = self._waiting
        goal = self._followed
        self._followed = None
        if waiting is not None and waiting.is_goal:
            self._waiting = None
            goal = waiting
            when = ""
        if goal is not None and goal.is_goal:
            goal.end(State.ABORTED, ResultCode.INVALID_GOAL, f"{reason}{when}")
            self._deliver(goal, wanted=wanted)

    def _deliver(self, request: TrajectoryRequest, *, wanted: bool = False) -> None:
        """Have the client of a goal learn how it has ended, and note it."""
        aborted = request.state is State.ABORTED
        if request.on_result is not None:
            self._post(request.on_result)
            self._note(one_line(f"goal {request.state.value}: {request.reason}"), wrong=aborted and not wanted)
        elif aborted:
            self._note(f"trajectory aborted: {request.reason}; stopping and holding", wrong=True)

    def _refused(self, kind: str, error: TrajectoryError, *, quiet: bool = False) -> None:
        """Count a goal or a trajectory that was refused, and store the reason, unless its result contains it."""
        self.rejected += 1
        self.last_rejection = f"{kind} at {self._cs7b.position_tick * self._period:.3f} s: {error}"
        if not quiet:
            self._note(f"{kind} rejected: {error}", wrong=True)

    def _note_dropped(self, why: str) -> None:
        """Note that a trajectory comes to no end, if one runs or waits for its start."""
        now = self._cs7b.position_tick
        if self._cs7b.trajectory.moving(now):
            self._note(f"trajectory dropped at {now * self._period:.3f} s: {why}")

    def _note(self, text: str, *, wrong: bool = False) -> None:
        self._post(partial(self._outputs.error if wrong else self._outputs.info, text))

    def _post(self, call: Callable[[], None]) -> None:
        """Let `report` call a function, after the messages stored before."""
        self._reports.append(call)
        self._outputs.wake()


def _reason_replaced(request: TrajectoryRequest) -> str:
    return "pre-empted by a new goal" if request.is_goal else "replaced by a trajectory on the topic"
