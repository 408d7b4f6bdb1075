"""The CS7B in operation: it holds the arm, follows trajectories and can be switched off; needs no ROS."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, Protocol

import numpy as np

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.motor_messages import MotorStates
from rx90_controller.goals.request import TrajectoryRequest
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.supervision import DriveFault
from rx90_controller.node.requests import Log, Requests
from rx90_controller.trajectory import Plan

INACTIVE: Final = "the controller is inactive; accepted: in state active"


_ATTEMPTS = 3  # to join a long trajectory beside the ticks, each with more time than the one before
_Record = np.ndarray[Any, Any]


class LawChanges:
    """Hands constants of the law from the executor's thread to the one that ticks.

    They count from a tick of the position loop on: before it the velocity loop would have gains that do not belong to
    the torque of the position loop. Integrators, which hold torques, go on as they are.

    Args:
        law: that is changed, shape (1,), CONTROLLER_DTYPE.
        post: has something called later, on the executor's thread.
    """

    def __init__(self, law: _Record, post: Callable[[Callable[[], None]], None]) -> None:
        self._law, self._post = law, post
        self.waiting: deque[tuple[_Record, Callable[[int], None]]] = deque()

    def add(self, law: _Record, effective: Callable[[int], None]) -> None:
        """Let these constants count soon; `effective` is then called with the time of the first tick, ns."""
        self.waiting.append((law, effective))

    def apply(self, stamp_ns: int) -> None:
        """Let those that wait count from this tick of the position loop on."""
        while self.waiting:
            self._law[:], effective = self.waiting.popleft()
            self._post(partial(effective, stamp_ns))


class Outputs(Log, Protocol):
    """Where set-points, tracking errors, accepted trajectories and lines for the user go.

    Attributes:
        ready: the line that says that the first states have come.
    """

    ready: str

    def wait_for_subscribers(self) -> None:
        """Wait, not without end, until those who listen will get the first message."""

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left."""


class ServoLoop:
    """Runs the CS7B as `ServoLoops` says; trajectories and switches may come from another thread, between ticks.

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
        law_changes: other constants of the law, from the next tick of the position loop on.
    """

    def __init__(self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int = 50) -> None:
        self._cs7b, self._outputs = cs7b, outputs
        self._requests = Requests(cs7b, outputs, horizon, monitor_ticks)
        self._lock = threading.Lock()
        self.command = cs7b.command
        self.active = self.enabled = True
        self.fault: DriveFault | None = None
        self._released = False  # switched off since the last tick: also if it is on again by now, the motion is over
        self.law_changes = LawChanges(cs7b.law, self._requests.post)
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
            if self.law_changes.waiting and cs7b.on_position_tick:
                self.law_changes.apply(stamp_ns)
            if self._released or not self.enabled:
                self._released = False
                self._requests.note_dropped("the torque is off")
                cs7b.release(states.position, stamp_ns // cs7b.rates.period_ns + 1)
                return False
            slow = cs7b.on_position_tick
            if slow:
                self._requests.note_end()
            cs7b.step(states.position, states.velocity, states.torque)
            self._unpublished = slow
            if cs7b.fault is None:
                return True
            if cs7b.fault.parameter:
                self._unpublished = False  # torques that are no numbers
            self._publish(stamp_ns)  # before the reset: what has led to the fault is to be seen
            self._trip(cs7b.fault)
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

    def _trip(self, fault: DriveFault) -> None:
        self.enabled, self.fault = False, fault
        text = f"{fault}; torque off, brakes closed, trajectory dropped, until ~/enable is called with true"
        self._requests.note(text, wrong=True)
        self._requests.drop(f"{fault}; torque off, brakes closed")

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

    @property
    def rejections(self) -> tuple[int, str]:
        """Return how many trajectories and goals were refused, and which was the last, when and why."""
        return self._requests.rejected, self._requests.last_rejection

    @contextmanager
    def joined(self, request: TrajectoryRequest) -> Iterator[tuple[Requests, Plan | None]]:
        """Give the requests between two ticks, and the plan of a long trajectory that was joined beside the ticks.

        Where the motion changes meanwhile, or the time was too short, it is joined again. Without a plan, as for a
        short trajectory, and where no attempt was in time, it is to be joined between the two ticks.
        """
        for attempt in range(_ATTEMPTS if request.long else 0):
            with self.between_ticks() as requests:
                plan = requests.plan(request, attempt) if self.running and not self.inactive else None
            if plan is None:
                break
            plan.join()
            with self.between_ticks() as requests:
                if requests.fits(plan):
                    yield requests, plan
                    return
        with self.between_ticks() as requests:
            yield requests, None

    def offer(self, trajectory: Any) -> None:
        """Follow a trajectory_msgs/JointTrajectory, at the latest once there are states; the log says if not.

        One without points stops the arm.
        """
        try:
            with self.between_ticks():
                if self.running and self.inactive:
                    raise TrajectoryError(self.inactive)
            request = self._requests.checked(trajectory)
        except TrajectoryError as error:
            with self.between_ticks() as requests:
                requests.refused("trajectory", error)
            return
        with self.joined(request) as (requests, plan):
            if self.running:
                requests.take(request, self.inactive, plan)
            else:
                requests.wait(request)

    def report(self) -> None:
        """Print and publish what there is to say; called after each `Outputs.wake`."""
        self._requests.report()
