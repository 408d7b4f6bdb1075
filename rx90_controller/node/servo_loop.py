"""The controller's ticks and its requests: where the thread that ticks and the executor's meet; needs no ROS.

| thread | may call |
|---|---|
| the one that ticks | `begin`, `hold`, `step`, `after_command`, `skip` |
| the executor's | `receive`, `receive_correction`, `receive_stream`, `offer`, `report`, and what any thread may |
| any | `post` and what posts: `enable`, `change_law`; `change`, `scale_speed`, `query` |

Events stand in one queue, in the order in which they come; between two ticks the present state answers them
(rx90_controller/servo/states.py), on the thread that has posted one, at the latest. An event is answered when `post`
returns, also while no ticks run. What takes long, checks and the motion of long trajectories, is done before, outside
the ticks. What is printed, published or sent to clients waits for `report`.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rx90_common.base.arrays import Array, Record
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.pacing import ThrottledLog
from rx90_common.exchange.topics import CORRECTED
from rx90_controller.law.cs7b import CS7B
from rx90_controller.servo.events import (
    Begin,
    Event,
    Fault,
    LawChange,
    Offer,
    Streamed,
    TorqueSwitch,
)
from rx90_controller.servo.servo import MotorStates, Outputs, Servo
from rx90_controller.servo.states import ServoState, Unstarted
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.generator import points_left
from rx90_controller.trajectory.points import (
    correction_from_points,
    points_from_message,
    trajectory_identity,
)
from rx90_controller.trajectory.request import (
    GoalOptions,
    GoalTolerances,
    JoinedAhead,
    State,
    TrajectoryRequest,
    check_request,
)
from rx90_controller.trajectory.stream import SetPoints, from_trajectory

# to join a long trajectory outside the ticks, each with more time than the one before
_ATTEMPTS = 3


class ServoLoop:
    """Runs the CS7B tick by tick, and hands events to its state.

    Args:
        cs7b: the control law, warmed up.
        outputs: receive set-points and errors, and the results of requests.
        horizon: how far ahead of its own time, s, a request may start.
        monitor_ticks: position ticks from one feedback of a goal to the next.

    Attributes:
        between_ticks: lock that keeps ticks from running; its holder may call no method of this class.
        state: the present one; it begins without motor states, switched on.
        servo: what the states act on.
        command: see `CS7B`.
        options: permitted exceptions from the checks; of the next requests.
        tolerances: of trajectories, and of goals without tolerances of their own; likewise.
    """

    def __init__(
        self, cs7b: CS7B, outputs: Outputs, horizon: float, monitor_ticks: int = 50
    ) -> None:
        self.between_ticks = threading.Lock()
        self.state: ServoState = Unstarted()
        self.servo = Servo(cs7b, outputs, horizon, monitor_ticks)
        self.servo.complain_of_source = ThrottledLog(
            self.servo.complain
        ).say  # set-points come by the hundred
        self.command = cs7b.command
        self.options = GoalOptions()
        self.tolerances = GoalTolerances.of_parameters(cs7b.joint_names)
        self._cs7b = cs7b
        self._events: deque[Event] = deque()
        self._unpublished = False  # whether the position loop has left something
        # for the trajectory of that identity
        self._correction: tuple[str, Correction] | None = None

    # The thread that ticks.

    def begin(self) -> None:
        """Wait for the subscribers."""
        self.servo.outputs.wait_for_subscribers()

    def hold(self, states: MotorStates) -> None:
        """Hold the arm where it is; a request that waited for the first states begins."""
        self.post(Begin(states.stamp_ns, states.position))

    def step(self, stamp_ns: int, states: MotorStates) -> bool:
        """Run the loops that are due; return whether the motors get torque."""
        cs7b = self._cs7b
        servo = self.servo
        with self.between_ticks:
            slow = cs7b.on_position_tick
            before = self.state
            if slow:
                if servo.law_changes:
                    servo.change_law(stamp_ns)
                if before.torque:
                    servo.note_end_of_motion()
                    before = before.settle(servo)
            self.state = before.tick(servo, states)
            if not (before.torque and self.state.torque):
                return False
            self._unpublished = slow
            fault = cs7b.fault
            if fault is None:
                return True
            if fault.quantity == "torque":
                self._unpublished = False  # torques that are no numbers
            # before the reset: the values that led to the fault must be visible
            self._publish(stamp_ns)
            self.state = self.state.answer(servo, Fault(fault, states.position))
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
            self.state = self.state.watch(self.servo)
            self.servo.outputs.publish(stamp_ns)

    # Any thread.

    def post(self, event: Event) -> None:
        """Have the state answer an event between two ticks, after those that came before."""
        self._events.append(event)
        with self.between_ticks:
            while self._events:
                self.state = self.state.answer(self.servo, self._events.popleft())

    def enable(self, on: bool) -> str:
        """Switch the torque on or off; return why it cannot be switched on, empty if it is done."""
        self.post(TorqueSwitch(on))
        return self.state.switch.refusal if on else ""

    def change_law(self, law: Record, effective: Callable[[int], None]) -> None:
        """Let other constants of the law, shape (1,), CONTROLLER_DTYPE, count from the next position tick on.

        Before it the velocity loop would have gains that do not belong to the torque of the position loop. Integrators,
        which hold torques, go on as they are. `effective` is then called, by `report`, with the time of that tick, ns.
        """
        self.post(LawChange(law, effective))

    def change(
        self, *, options: GoalOptions | None = None, tolerances: GoalTolerances | None = None
    ) -> int:
        """Let others count for the next requests; return the time of the first tick that may be one's, ns."""
        with self.between_ticks:
            self.options = options or self.options
            self.tolerances = tolerances or self.tolerances
            return self._cs7b.position_tick * self._cs7b.rates.ratio * self._cs7b.rates.period_ns

    def scale_speed(self, factor: float) -> None:
        """Follow trajectories at a share of their speed, from now on.

        Raises:
            TrajectoryError: if the factor is not a number in [0, 1].
        """
        with self.between_ticks:
            self.servo.trajectory.set_speed_scaling(factor, self.servo.tick)

    def query(self, tick: float) -> tuple[Array, bool]:
        """Return the set-point at a time in position ticks, shape (3, j), and whether a motion runs until then.

        Raises:
            TrajectoryError: for a time before the running motion.
        """
        with self.between_ticks:
            trajectory = self.servo.trajectory
            return trajectory.state(tick), trajectory.moving(math.ceil(tick) - 1)

    # The executor's thread.

    def receive(
        self, message: Any, goal: Any = None, missing: str = ""
    ) -> TrajectoryRequest | None:
        """Return a trajectory, checked by itself; None if it is refused, which is logged, or if it is of a stream.

        A trajectory of the topic is followed at once; a goal is left to `offer`, and must have points in the future.

        Args:
            message: trajectory_msgs/JointTrajectory; of the topic, one without points is a stop.
            goal: the goal of FollowJointTrajectory that contains it.
            missing: a further reason why no goal can be followed now, besides the state's.
        """
        kind = "trajectory" if goal is None else "goal"
        if goal is None and self._is_streamed(message):
            self.receive_stream(partial(self._streamed, message), "the trajectory topic")
            return None
        try:
            request = check_request(
                message, self.tolerances, self.options, self._cs7b.rates.position_hz, goal
            )
            self._correct(request)
            if goal is not None:
                self._check_goal(request, missing)
        except TrajectoryError as error:
            self.servo.reject(kind, error)
            return None
        if request.remark:
            self.servo.complain(f"{kind}: {request.remark}")
        if goal is None:
            self.offer(request)
        return request

    def _check_goal(self, request: TrajectoryRequest, missing: str) -> None:
        with self.between_ticks:
            reason = self.state.switch.refusal or missing
            if reason:
                raise TrajectoryError(reason)
            assert request.points is not None
            points_left(request.points, self.servo.tick, request.start, self.servo.period)

    def offer(self, request: TrajectoryRequest) -> None:
        """Follow a request, at the latest once there are states, or refuse it.

        A long one is joined to the motion outside the ticks; if the motion changes meanwhile, or the time was too
        short, again with more time. A short one, and one that never was in time, is joined between two ticks.
        """
        for attempt in range(_ATTEMPTS if request.long else 0):
            with self.between_ticks:
                if not self.state.torque:
                    break
                joined = JoinedAhead(request, self.servo.trajectory, self.servo.tick, attempt)
            joined.compute()
            self.post(Offer(request, joined))
            if request.state is not State.RECEIVED:
                return
        self.post(Offer(request))

    def receive_stream(self, read: Callable[[], SetPoints], source: str) -> None:
        """Follow set-points of a stream in place of the running motion, or refuse them, which is logged now and then.

        Args:
            read: returns them, or raises TrajectoryError.
            source: name of the source, in words.
        """
        try:
            points = read()
        except TrajectoryError as error:
            self.servo.refuse_set_points(source, error)
        else:
            self.post(Streamed(points, source))

    def _is_streamed(self, message: Any) -> bool:
        """Return whether a trajectory of the topic is a set-point of a stream: its end is as near as that of one."""
        state = self.state
        if not state.started or not len(message.points):
            return False
        window = self.servo.streaming.window
        start = message_time_ns(message.header.stamp) / NANOSECONDS
        end = message_time_ns(message.points[-1].time_from_start) / NANOSECONDS
        ahead = end + (start - self.servo.time if start else 0.0)
        least = 0.0 if state.stream is None else -window
        return end > 0.0 and least < ahead <= window

    def _streamed(self, message: Any) -> SetPoints:
        partial_joints = self.options.allow_partial_joints_goal
        names = self._cs7b.joint_names
        points = points_from_message(names, message, partial=partial_joints, moving_end=True)
        return from_trajectory(points, message_time_ns(message.header.stamp))

    def receive_correction(self, message: Any) -> None:
        """Keep offsets for the trajectory whose identity is in their frame, until it arrives, or another correction.

        Args:
            message: trajectory_msgs/JointTrajectory: a point with positions, the offsets in rad, for each set-point.
        """
        self._correction = None
        try:
            points = points_from_message(self._cs7b.joint_names, message)
            correction = correction_from_points(points, self.servo.period)
        except TrajectoryError as error:
            self.servo.reject("correction", error)
            return
        self._correction = (message.header.frame_id, correction)

    def _correct(self, request: TrajectoryRequest) -> None:
        """Give a request the correction that waits for it.

        Raises:
            TrajectoryError: if it is not to run without one, and none waits for it.
        """
        requested = request.message.header.frame_id == CORRECTED
        waiting = self._correction
        points = request.points
        if points is None or (waiting is None and not requested):
            return
        self._correction = None
        if waiting is not None and waiting[0] == trajectory_identity(points):
            request.correction = waiting[1]
        elif requested:
            raise TrajectoryError(
                "its correction has not come; accepted: after it on ~/commanded_correction"
            )
        else:
            self.servo.note("the correction that waited belongs to another trajectory; dropped")

    def report(self) -> None:
        """Print, publish and send what has come up; called after each `Outputs.wake`."""
        self.servo.report()
