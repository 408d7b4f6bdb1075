"""The CS7B in operation: it holds the arm, follows trajectories and can be switched off; needs no ROS."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_common.exchange.motor_messages import MotorStates
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory import Schedule
from rx90_controller.trajectory.message import check_joint_names, points_from_message, start_tick


class Outputs(Protocol):
    """Where set-points, tracking errors, accepted trajectories and lines for the user go."""

    def wait_for_subscribers(self) -> None:
        """Wait, not without end, until those who listen will get the first message."""

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left."""

    def wake(self) -> None:
        """Have `ServoLoop.report` called soon, by another thread than the one that ticks."""

    def accepted(self, trajectory: Any, start_ns: int) -> None:
        """Publish a trajectory that was taken, and when it starts, ns."""

    def info(self, text: str) -> None:
        """Print what happened."""

    def error(self, text: str) -> None:
        """Print what went wrong."""


class ServoLoop:
    """Runs the CS7B as `ServoLoops` says; trajectories and switches may come from another thread, between ticks.

    Args:
        cs7b: the control law, warmed up.
        outputs: get what it does, and what became of a trajectory.
        horizon: how far ahead of its own time, s, a trajectory may start.

    Attributes:
        command: see `CS7B`.
        enabled: whether the motors get torque.
        running: whether there have been states.
        rejected: number of trajectories that were refused.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float) -> None:
        self._cs7b, self._outputs, self._horizon = cs7b, outputs, horizon
        self._lock = threading.Lock()
        self.command = cs7b.command
        self.enabled = True
        self.running = False
        self.rejected = 0
        self._waiting: Any = None
        self._stopping = False
        self._reports: deque[Callable[[], None]] = deque()

    # The ticking thread. What it has to say is left to another one: printing may take longer than a tick.

    def begin(self) -> None:
        """Wait for the subscribers."""
        self._outputs.wait_for_subscribers()

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is; a trajectory that waited for the first states begins."""
        with self._lock:
            self._cs7b.reset(states.position, states.stamp_ns // self._cs7b.rates.period_ns)
            self.running = True
            waiting, self._waiting = self._waiting, None
            if waiting is not None:
                self._take(waiting)
                self._outputs.wake()

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the loops that are due; return whether the motors get torque."""
        cs7b = self._cs7b
        with self._lock:
            if not self.enabled:
                cs7b.reset(states.position, stamp_ns // cs7b.rates.period_ns + 1)
                return False
            slow = cs7b.on_position_tick
            if slow:
                self._note_end(cs7b.trajectory.ended(cs7b.position_tick))
            cs7b.step(states.position, states.velocity)
            if slow:
                self._outputs.publish(stamp_ns)
            return True

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points: a running trajectory comes later."""
        with self._lock:
            self._cs7b.skip(count)

    def _note_end(self, tick: int | None) -> None:
        if tick is None:
            return
        what = "stopped" if self._stopping else "trajectory ended"
        self._say(f"{what} at {tick * self._cs7b.rates.position_period:.3f} s; holding")
        self._outputs.wake()

    # Any thread.

    def enable(self, on: bool) -> None:
        """Switch the torque on or off; off, the brakes hold the arm."""
        with self._lock:
            self.enabled = on

    # The executor's thread.

    def offer(self, trajectory: Any) -> None:
        """Follow a trajectory_msgs/JointTrajectory, at the latest once there are states; the log says if not.

        One without points stops the arm.
        """
        with self._lock:
            if self.running:
                self._take(trajectory)
            else:
                self._waiting = trajectory
                self._say("a trajectory waits for the simulation's first tick")
        self.report()

    def report(self) -> None:
        """Print and publish what there is to say."""
        while self._reports:
            self._reports.popleft()()

    def _take(self, trajectory: Any) -> None:
        """Accept or refuse a trajectory, and note what to say of it."""
        try:
            if not self.enabled:
                raise TrajectoryError("the controller is disabled; accepted: after a call of ~/enable with true")
            schedule, text = self._stop(trajectory) if not trajectory.points else self._follow(trajectory)
        except TrajectoryError as error:
            self.rejected += 1
            self._reports.append(partial(self._outputs.error, f"trajectory rejected: {error}"))
            return
        self._stopping = not trajectory.points
        start_ns = schedule.begin * self._cs7b.rates.period_ns * self._cs7b.rates.ratio
        self._reports.append(partial(self._outputs.accepted, trajectory, start_ns))
        self._say(text)

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
        rates, now = self._cs7b.rates, self._cs7b.position_tick
        start = start_tick(trajectory, rates.position_hz)
        if start is not None and start - now > self._horizon * rates.position_hz:
            raise TrajectoryError(
                f"start time {start / rates.position_hz:.3f} s, the controller's time is "
                f"{now / rates.position_hz:.3f} s; accepted: 0 for now, or simulated time within {self._horizon:g} s"
            )
        return start

    def _say(self, text: str) -> None:
        self._reports.append(partial(self._outputs.info, text))
