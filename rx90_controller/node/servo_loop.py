"""The CS7B in operation: it holds the arm, follows trajectories and can be switched off; needs no ROS."""

from __future__ import annotations

import threading
from typing import Any, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_common.exchange.motor_messages import MotorStates
from rx90_controller.law.cs7b import CS7B
from rx90_controller.trajectory.message import points_from_message, start_tick


class Outputs(Protocol):
    """Where set-points, tracking errors and lines for the user go."""

    def wait_for_subscribers(self) -> None:
        """Wait, not without end, until those who listen will get the first message."""

    def ready(self) -> None:
        """Print, once, that the first states have come."""

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left."""

    def info(self, text: str) -> None:
        """Print what happened."""

    def error(self, text: str) -> None:
        """Print what went wrong."""


class ServoLoop:
    """Runs the CS7B as `ServoLoops` says; trajectories and switches may come from another thread, between ticks.

    Args:
        cs7b: the control law, warmed up.
        outputs: get what it does, and what became of a trajectory.

    Attributes:
        command: see `CS7B`.
        enabled: whether the motors get torque.
        running: whether there have been states.
        rejected: number of trajectories that were refused.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs) -> None:
        self._cs7b, self._outputs = cs7b, outputs
        self._lock = threading.Lock()
        self.command = cs7b.command
        self.enabled = True
        self.running = False
        self.rejected = 0
        self._waiting: Any = None

    # The ticking thread.

    def begin(self) -> None:
        """Wait for the subscribers."""
        self._outputs.wait_for_subscribers()

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is; a trajectory that waited for the first states begins."""
        with self._lock:
            self._cs7b.reset(states.position, states.stamp_ns // self._cs7b.rates.period_ns)
            if not self.running:
                self._outputs.ready()
            self.running = True
            waiting, self._waiting = self._waiting, None
            if waiting is not None:
                self._accept(waiting)

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the loops that are due; return whether the motors get torque."""
        cs7b = self._cs7b
        with self._lock:
            if not self.enabled:
                cs7b.reset(states.position, stamp_ns // cs7b.rates.period_ns + 1)
                return False
            slow = cs7b.on_position_tick
            cs7b.step(states.position, states.velocity)
            if slow:
                self._outputs.publish(stamp_ns)
            return True

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points: a running trajectory comes later."""
        with self._lock:
            self._cs7b.skip(count)

    # Any thread.

    def enable(self, on: bool) -> None:
        """Switch the torque on or off; off, the brakes hold the arm."""
        with self._lock:
            self.enabled = on

    def offer(self, trajectory: Any) -> None:
        """Follow a trajectory_msgs/JointTrajectory, at the latest once there are states; the log says if not."""
        with self._lock:
            if self.running:
                self._accept(trajectory)
            else:
                self._waiting = trajectory
                self._outputs.info("a trajectory waits for the simulation's first tick")

    def _accept(self, trajectory: Any) -> None:
        cs7b = self._cs7b
        try:
            if not self.enabled:
                raise TrajectoryError("the controller is disabled; accepted: after a call of ~/enable with true")
            points = points_from_message(cs7b.joint_names, trajectory)
            start = start_tick(trajectory, cs7b.rates.position_hz)
            begin = cs7b.trajectory.accept(points, cs7b.position_tick, start)
        except TrajectoryError as error:
            self.rejected += 1
            self._outputs.error(f"trajectory rejected: {error}")
            return
        period = cs7b.rates.position_period
        self._outputs.info(
            f"trajectory accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin * period:.3f} s"
        )
