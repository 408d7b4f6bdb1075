"""The CS7B in operation: it holds the arm, follows trajectories and can be switched off; needs no ROS."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

import numpy as np

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.motor_messages import MotorStates
from rx90_controller.law.cs7b import CS7B, DriveFault
from rx90_controller.node.requests import Outputs, Requests
from rx90_controller.trajectory.request import TrajectoryRequest

INACTIVE: Final = "the controller is inactive; accepted: in state active"
_ATTEMPTS = 3  # to join a long trajectory beside the ticks, each with more time than the one before


class ServoLoop:
    """Runs the CS7B as `ServoLoops` says; requests and switches may come from another thread, between ticks.

    Args:
        cs7b: the control law, warmed up.
        outputs: get what it does, and what became of a trajectory.
        horizon: how far ahead of its own time, s, a trajectory may start.
        monitor_ticks: position ticks from one feedback of a goal to the next.

    Attributes:
        command: see `CS7B`.
        active, enabled: whether the node is active, and whether the motors get torque.
        fault: why the supervision has cut the power, until it is switched on again.
        running: whether there have been states.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int = 50) -> None:
        self._cs7b, self._outputs = cs7b, outputs
        self._requests = Requests(cs7b, outputs, horizon, monitor_ticks)
        self._lock = threading.Lock()
        self.command = cs7b.command
        self.active = self.enabled = True
        self.fault: DriveFault | None = None
        self._released = False  # switched off since the last tick: also if it is on again by now, the motion is over
        self._law_changes: deque[tuple[np.ndarray[Any, Any], Callable[[int], None]]] = deque()
        self.running = self._unpublished = False  # whether the position loop has left something

    # The ticking thread.

    def begin(self) -> None:
        """Wait for the subscribers."""
        self._outputs.wait_for_subscribers()

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is; a trajectory that waited for the first states begins."""
        with self._lock:
            if self.running:
                reason = f"the states go on from {states.stamp_ns / NANOSECONDS:.6g} s; holding"
                self._requests.note_dropped(reason)
                self._requests.drop(reason)
            else:
                self._requests.note(self._outputs.ready)
            self._cs7b.reset(states.position, states.stamp_ns // self._cs7b.rates.period_ns)
            self.running = True
            self._requests.begin(self.inactive)

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the loops that are due; return whether the motors get torque."""
        cs7b = self._cs7b
        with self._lock:
            slow = cs7b.on_position_tick
            while self._law_changes and slow:
                cs7b.law[:], effective = self._law_changes.popleft()
                self._requests.post(partial(effective, stamp_ns))
            if self._released or not self.enabled:
                self._released = False
                self._requests.note_dropped("the torque is off")
                cs7b.release(states.position, stamp_ns // cs7b.rates.period_ns + 1)
                return False
            if slow:
                self._requests.note_end()
            cs7b.step(states.position, states.velocity, states.torque)
            self._unpublished = slow
            fault = cs7b.fault
            if fault is None:
                return True
            if fault.parameter:
                self._unpublished = False  # torques that are no numbers
            self._publish(stamp_ns)  # before the reset: what has led to the fault is to be seen
            self.enabled, self.fault = False, fault
            text = f"{fault}; torque off, brakes closed, trajectory dropped, until ~/enable is called with true"
            self._requests.note(text, wrong=True)
            self._requests.drop(f"{fault}; torque off, brakes closed")
            cs7b.release(states.position, cs7b.tick)
            return False

    def after_command(self, stamp_ns: int) -> None:
        """Publish what the last step has left: after its command, for which the simulation waits."""
        with self._lock:
            self._publish(stamp_ns)

    def _publish(self, stamp_ns: int) -> None:
        if self._unpublished:
            self._unpublished = False
            self._requests.step()
            self._outputs.publish(stamp_ns)

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points: a running trajectory comes later."""
        with self._lock:
            self._cs7b.skip(count)

    # Any thread.

    def enable(self, on: bool, why: str = "the torque is off") -> None:
        """Switch the torque on or off; off, the brakes hold the arm, and the goal ends with `why`."""
        with self._lock:
            self.enabled = on
            if on:
                self.fault = None
            else:
                self._released = True
                self._requests.drop(why)

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
        """Return why nothing can be followed now, and what is accepted; empty if something can."""
        if not self.active:
            return INACTIVE
        if self.fault is not None:
            return f"{self.fault}; torque off; accepted: after a call of ~/enable with true"
        if not self.enabled:
            return "the controller is disabled; accepted: after a call of ~/enable with true"
        return "the torque comes back with the next tick; accepted: from then on" if self._released else ""

    @contextmanager
    def between_ticks(self) -> Iterator[Requests]:
        """Give the requests; no tick is run until the block is left."""
        with self._lock:
            yield self._requests

    # The executor's thread.

    def receive(self, message: Any) -> None:
        """Follow a trajectory_msgs/JointTrajectory of the topic; the log says if not. One without points is a stop."""
        try:
            with self._lock:
                if self.running and self.inactive:
                    raise TrajectoryError(self.inactive)
            request = self._requests.checked(message)
        except TrajectoryError as error:
            with self._lock:
                self._requests.refused("trajectory", error)
        else:
            self.offer(request)

    def receive_goal(self, goal: Any, missing: str = "") -> TrajectoryRequest | None:
        """Return a goal of FollowJointTrajectory, checked wherever the arm is; None if it is refused: the log says why.

        `missing` is why no goal can be followed now, beside `inactive`.
        """
        try:
            request = self._requests.checked(goal.trajectory, goal)
            with self._lock:
                self._requests.check_goal(request, self.inactive or missing)
        except TrajectoryError as error:
            with self._lock:
                self._requests.refused("goal", error)
            return None
        return request

    def offer(self, request: TrajectoryRequest) -> None:
        """Follow a request, at the latest once there are states, or refuse it.

        A long one is joined to the motion beside the ticks; where the motion changes meanwhile, or the time was too
        short, once more with more time. A short one, and one that was never in time, is joined between two ticks.
        """
        for attempt in range(_ATTEMPTS if request.long else 0):
            with self._lock:
                if not self.running or self.inactive:
                    break
                joined = self._requests.joined_ahead(request, attempt)
            joined.compute()
            with self._lock:
                if self.running and self._requests.fits(joined):
                    self._requests.follow(request, self.inactive, joined)
                    return
        with self._lock:
            if self.running:
                self._requests.follow(request, self.inactive)
            else:
                self._requests.wait(request)

    def report(self) -> None:
        """Print and publish what there is to say; called after each `Outputs.wake`."""
        self._requests.report()
