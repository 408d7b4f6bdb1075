"""What the states of the controller act on: the law with its motion, the log, and the clients of goals."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import counted, one_line
from rx90_common.exchange.topics import OF_ACTION
from rx90_controller.law.cs7b import CS7B
from rx90_controller.servo.events import Begin, LawChange
from rx90_controller.trajectory.generator import PastError, Schedule
from rx90_controller.trajectory.request import JoinedAhead, ResultCode, State, TrajectoryRequest
from rx90_controller.trajectory.stream import StreamOptions


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
        """Have `Servo.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int, source: str) -> None:
        """Publish a trajectory that is followed, when it starts, ns, and OF_ACTION for one that was a goal."""

    def info(self, text: str) -> None:
        """Print an event."""

    def error(self, text: str) -> None:
        """Print a problem."""


class Servo:
    """The law and its motion, and whom the states tell what they do.

    To print may take longer than a tick: messages are kept until `report`.

    Args:
        cs7b: the control law, warmed up.
        outputs: receive set-points and errors, and the results of requests.
        horizon: how far ahead of its own time, s, a request may start.
        monitor_ticks: position ticks from one feedback of a goal to the next.

    Attributes:
        streaming: how streamed set-points are joined.
        law_changes: that wait for the next tick of the position loop.
        rejected: number of requests, and set-points of streams, that were refused.
        last_rejection: the last of them, with time and reason; empty before the first.
        complain_of_source: has a problem of a stream printed; the owner may do so now and then only.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int) -> None:
        self.cs7b = cs7b
        self.trajectory = cs7b.trajectory
        self.outputs = outputs
        self.period = cs7b.rates.position_period
        self.streaming = StreamOptions()
        self.rejected = 0
        self.last_rejection = ""
        self.law_changes: deque[LawChange] = deque()
        self._horizon = horizon
        self._monitor_ticks = monitor_ticks
        self._reports: deque[Callable[[], None]] = deque()
        self.complain_of_source: Callable[[str, str], None] = lambda _, text: self.complain(text)
        self._last_measured = (-1, np.zeros(len(cs7b.joint_names)))

    # Time and motion.

    @property
    def tick(self) -> int:
        """Return the first position tick that may still be changed."""
        return self.cs7b.position_tick

    @property
    def time(self) -> float:
        """Return the time of that tick, s."""
        return self.cs7b.position_tick * self.period

    @property
    def moving(self) -> bool:
        """Return whether a motion runs, is held on its path, or waits for its start."""
        return self.trajectory.moving(self.tick)

    def hold(self, event: Begin) -> None:
        """Begin anew: hold the motors where they are."""
        self.cs7b.reset(event.position, event.stamp_ns // self.cs7b.rates.period_ns)

    def release(self, position: Array) -> None:
        """Let a tick pass without torque: the set-points follow the motors, rad, shape (n,)."""
        self.note_dropped_motion("the torque is off")
        self.cs7b.release(position, self.cs7b.tick + 1)

    def change_law(self, stamp_ns: int) -> None:
        """Let the changes of the law count that have come."""
        while self.law_changes:
            change = self.law_changes.popleft()
            self.cs7b.law[:] = change.law
            self.post(partial(change.effective, stamp_ns))

    def measure(self) -> tuple[int, Array, Array]:
        """Return the last position tick with its set-point and what was measured, each shape (3, n).

        The measured acceleration is the difference of the velocities over a tick, if the one before was measured, too.
        """
        tick = self.tick - 1
        desired = self.cs7b.setpoint.copy()
        position, velocity = self.cs7b.measured()
        (last, before) = self._last_measured
        acceleration = (velocity - before) / self.period if tick == last + 1 else desired[2]
        self._last_measured = (tick, velocity)
        return tick, desired, np.stack([position, velocity, acceleration])

    # Requests.

    def enter(self, request: TrajectoryRequest, joined: JoinedAhead | None) -> Schedule | None:
        """Let the motion follow a request, perhaps joined already; None if it is refused, without any effect."""
        now = self.tick
        ahead = 0.0 if request.start is None else (request.start - now) * self.period
        try:
            if request.start is not None and ahead > self._horizon:
                raise TrajectoryError(
                    f"start time {request.start * self.period:.3f} s, the controller's time is {self.time:.3f} s; "
                    f"accepted: 0 for now, or simulated time within {self._horizon:g} s"
                )
            return request.enter(self.trajectory, now) if joined is None else joined.adopt(now)
        except TrajectoryError as error:
            self.refuse(request, error)
            return None

    def announce(self, request: TrajectoryRequest, schedule: Schedule) -> None:
        """Say that a request is followed, and publish it."""
        points = request.points
        begin = schedule.begin * self.period
        if points is None:
            end = schedule.end * self.period
            text = f"empty trajectory: stopping from {begin:.3f} s on, at rest at {end:.3f} s"
        else:
            count = counted(len(points.times), "point")
            text = f"{request.kind} accepted: {count}, {points.times[-1]:.3f} s from {begin:.3f} s"
            if points.smooth:
                text += "; velocities from its positions"
            if request.correction is not None:
                text += "; with its correction"
            if schedule.blend_error > 0.0:
                text += f"; its ramps pass the points in between at up to {schedule.blend_error:.3g} rad"
        start = schedule.begin if request.start is None or points is None else request.start
        start_ns = start * self.cs7b.rates.period_ns * self.cs7b.rates.ratio
        source = OF_ACTION if request.is_goal else ""
        self.post(partial(self.outputs.accepted, request.message, start_ns, source))
        self.note(text)

    def refuse(self, request: TrajectoryRequest, error: TrajectoryError) -> None:
        """End a request that cannot be followed; a goal's result says why, of a trajectory the log."""
        code = (
            ResultCode.OLD_HEADER_TIMESTAMP
            if isinstance(error, PastError)
            else ResultCode.INVALID_GOAL
        )
        self.count_refusal(request.kind, error)
        request.end(State.ABORTED, code, str(error))
        if request.is_goal:
            self.deliver(request)
        else:
            self.complain(f"{request.kind} rejected: {error}")

    def reject(self, kind: str, error: TrajectoryError) -> None:
        """Count what was refused, and say why."""
        self.count_refusal(kind, error)
        self.complain(f"{kind} rejected: {error}")

    def refuse_set_points(self, source: str, error: TrajectoryError) -> None:
        """Count set-points that are not followed, and say why now and then."""
        self.count_refusal("set-point", error)
        self.complain_of_source(source, f"set-point from {source} ignored: {error}")

    def count_refusal(self, kind: str, error: TrajectoryError) -> None:
        """Count what was refused, and keep the reason."""
        self.rejected += 1
        self.last_rejection = f"{kind} at {self.time:.3f} s: {error}"

    def abort(self, request: TrajectoryRequest, reason: str, *, wanted: bool = False) -> None:
        """End a goal with -1 and a reason; `wanted`: the end is no failure."""
        request.end(State.ABORTED, ResultCode.INVALID_GOAL, reason)
        self.deliver(request, wanted=wanted)

    def cancel(self, request: TrajectoryRequest, text: str) -> None:
        """End a goal that its client has taken back."""
        request.end(State.CANCELED, ResultCode.SUCCESSFUL, text)
        self.deliver(request)

    def deliver(self, request: TrajectoryRequest, *, wanted: bool = False) -> None:
        """Have the client of a goal learn how it has ended, and note it; of a trajectory note that it was aborted."""
        aborted = request.state is State.ABORTED
        if request.on_result is not None:
            self.post(request.on_result)
            text = one_line(f"goal {request.state.value}: {request.reason}")
            if aborted and not wanted:
                self.complain(text)
            else:
                self.note(text)
        elif aborted:
            self.complain(f"trajectory aborted: {request.reason}; stopping and holding")

    def feed_back(self, request: TrajectoryRequest, tick: int) -> None:
        """Have the client of a goal learn how far it is, now and then."""
        if (
            request.on_feedback is not None
            and request.feedback is not None
            and tick % self._monitor_ticks == 0
        ):
            self.post(partial(request.on_feedback, request.feedback))

    # The log.

    def note_end_of_motion(self) -> None:
        """Note that a motion has come to its end, once; to be called in each position tick."""
        end = self.trajectory.ended(self.tick)
        if end is not None:
            (tick, stop) = end
            what = "stopped" if stop else "trajectory ended"
            self.note(f"{what} at {tick * self.period:.3f} s; holding")

    def note_dropped_motion(self, reason: str) -> None:
        """Note that a motion comes to no end, if one runs or waits for its start."""
        if self.moving:
            self.note(f"trajectory dropped at {self.time:.3f} s: {reason}")

    def note(self, text: str) -> None:
        """Have an event printed."""
        self.post(partial(self.outputs.info, text))

    def complain(self, text: str) -> None:
        """Have a problem printed."""
        self.post(partial(self.outputs.error, text))

    def post(self, call: Callable[[], None]) -> None:
        """Let `report` call a function, after the messages stored before."""
        self._reports.append(call)
        self.outputs.wake()

    def report(self) -> None:
        """Print and publish the stored messages; called after each `Outputs.wake`, by another thread."""
        while self._reports:
            self._reports.popleft()()
