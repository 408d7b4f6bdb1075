"""The interfaces of joint_trajectory_controller: the action FollowJointTrajectory, and its topics and service.

To be imported only if control_msgs is installed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
from control_msgs.srv import QueryTrajectoryState
from numpy.typing import NDArray
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr import CdrBody
from rx90_common.exchange.cdr_stamps import ENCAPSULATION
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.endpoints import (
    LATCHED_QOS,
    REQUEST_QOS,
    STATE_QOS,
    ros_time,
    subscribe,
)
from rx90_common.exchange.pacing import error_log
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.servo.events import Cancel, GiveUp
from rx90_controller.trajectory.request import Feedback, State, TrajectoryRequest

_WATCH_PERIOD = 0.5  # s between two looks for the simulation, while there is a goal
_SIMULATION_TIMEOUT = 2.0  # s without one, after which the goal is given up
# s for which results are kept for clients that ask late; a goal may be large
_RESULT_TIMEOUT = 60.0
_RESULT_GRACE = 2.0  # s in which the client of the last goal may ask for its result
# turns of the executor in which a result is sent, and s of each at the most
_FLUSH_SPINS = 10
_SPIN_TIMEOUT = 0.01
_ENDS = "the controller ends"
_POINT_ROWS = ((1, 1, 1, 0), (1, 1, 0, 0), (1, 1, 0, 0), (0, 0, 0, 1))
"""Which of positions, velocities, accelerations, efforts the state's reference, feedback, error and output have."""
# points of joints that the arm has not, of three empty sequences and a time each
_OF_SEVERAL_AXES = 4


class _Server(ActionServer):
    """rclpy's server, for goals that others execute and that have ended when it learns of their end.

    Its own way is a function that runs while a goal does: it would keep the executor, or, if it waits for something,
    be called again and again, which takes a whole core (rclpy 7).
    """

    on_result_request: Callable[[bytes], object]

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Serve requests, and note the goal whose result is requested."""
        await super().execute(taken_data)
        if "result" in taken_data:
            self.on_result_request(bytes(taken_data["result"][1].goal_id.uuid))

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None
    ) -> None:
        """Do nothing: the goal is executed by the thread that ticks."""

    def finish(self, handle: ServerGoalHandle, end: Callable[[ServerGoalHandle], Any]) -> None:
        """Send the result that `end` returns once it has given the goal its last state."""
        super().notify_execute(handle, end)


class ClientInterfaces:
    """The action, speed scaling, state query and state topic of a controller.

    Goals are checked and answered on the executor's thread, and followed by the ticking one. A goal that is invalid by
    itself, or sent to a controller that is not active, is rejected. A goal that the arm's position then rules out
    (start, limits) is accepted and aborted at once: a result has a text, a rejection has none.

    Args:
        node: whose interfaces they are.
        loop: follows the goals.
        cs7b: of the loop.
        state_ticks: position ticks from one state to the next.
        channel: to the simulation.

    Attributes:
        publisher: of the state, for the check of its matched subscribers.
    """

    def __init__(
        self, node: Node, loop: ServoLoop, cs7b: CS7B, state_ticks: int, channel: TickChannel
    ) -> None:
        self._node = node
        self._loop = loop
        self._cs7b = cs7b
        self._channel = channel
        self._names = list(cs7b.joint_names)
        self._tick_ns = cs7b.rates.period_ns * cs7b.rates.ratio
        self._goals: dict[bytes, TrajectoryRequest] = {}  # that may still be cancelled
        self._result_requested: set[bytes] = set()  # goals whose client has asked for the result
        self._checked: TrajectoryRequest | None = None  # the goal that is accepted next
        # an executor of several threads continues while the node ends
        self._checking = threading.Lock()
        self._ending = False
        self._simulation_seen = time.monotonic()  # when the simulation was there
        qos = REQUEST_QOS
        self._server = _Server(
            node,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=lambda _: None,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            goal_service_qos_profile=qos,
            result_service_qos_profile=qos,
            cancel_service_qos_profile=qos,
            result_timeout=_RESULT_TIMEOUT,
        )
        self._server.on_result_request = self._on_result_request
        node.create_timer(_WATCH_PERIOD, self._watch_simulation)
        # Some repeat their speed scaling hundreds of times a second, right or wrong.
        self._complaints = error_log(node)
        self._scaling: float | None = None  # announced last
        # Latched, as the original has it: what was asked for before this node was there counts, too.
        subscribe(node, SpeedScalingFactor, "~/speed_scaling_input", self._on_scaling, LATCHED_QOS)
        node.create_service(QueryTrajectoryState, "~/query_state", self._on_query, qos_profile=qos)
        self.publisher = node.create_publisher(
            JointTrajectoryControllerState, "~/controller_state", STATE_QOS
        )
        self._state = _StateMessage(self._names)
        self._state_ns = self._tick_ns * state_ticks

    def end(self) -> None:
        """End the active goal because the node ends, and send its result; take no other."""
        with self._checking:
            self._ending, ending = True, set(self._goals)
            self._loop.post(GiveUp(_ENDS))
        self._loop.report()
        executor = self._node.executor
        until = time.monotonic() + _RESULT_GRACE
        spins = _FLUSH_SPINS
        # A client that requested a result while another goal was checked has not been answered yet.
        while executor is not None and spins > 0:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT if ending else 0.0)
            if (ending <= self._result_requested and not self._goals) or time.monotonic() > until:
                spins -= 1

    def close(self) -> None:
        """Serve no more goals; those that there were have ended."""
        self._server.destroy()

    # Requests of clients, in the order in which they come.

    def _on_goal(self, goal: Any) -> GoalResponse:
        with self._checking:
            there = self._channel.matches().publishers > 0
            missing = "" if there else "there is no simulation; accepted: once there is one"
            self._checked = self._loop.receive(
                goal.trajectory, goal, _ENDS if self._ending else missing
            )
        return GoalResponse.REJECT if self._checked is None else GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        """Follow the goal that was checked just before, once its client has got the answer."""
        with self._checking:
            goal = self._checked
            assert goal is not None
            handle.execute()
            goal.on_feedback = partial(self._send_feedback, handle)
            goal.on_result = partial(self._finish, handle, goal)
            self._goals[bytes(handle.goal_id.uuid)] = goal
            self._loop.offer(goal)
            if self._ending:
                self._loop.post(GiveUp(_ENDS))

    def _on_result_request(self, name: bytes) -> None:
        if name in self._goals or self._ending:
            self._result_requested.add(name)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Cancel a goal; where its end is on the way already, its client gets that."""
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is not None:
            self._loop.post(Cancel(goal))
        return CancelResponse.ACCEPT

    def _watch_simulation(self) -> None:
        """Abort the goal if its simulation no longer exists."""
        now = time.monotonic()
        if not self._loop.state.has_goal or self._channel.matches().publishers > 0:
            self._simulation_seen = now
        elif now - self._simulation_seen > _SIMULATION_TIMEOUT:
            self._loop.post(
                GiveUp(
                    f"the simulation is gone, for more than {_SIMULATION_TIMEOUT:g} s", halt=True
                )
            )

    def _on_scaling(self, message: SpeedScalingFactor) -> None:
        """Follow trajectories at the requested share of their speed, from now on."""
        try:
            self._loop.scale_speed(message.factor)
        except TrajectoryError as error:
            self._complaints.say("factor", f"{error}; ignored")
            return
        if message.factor != self._scaling:
            self._scaling = message.factor
            self._node.get_logger().info(f"speed scaling {message.factor:g}")

    def _on_query(
        self, request: QueryTrajectoryState.Request, response: QueryTrajectoryState.Response
    ) -> QueryTrajectoryState.Response:
        """Answer with the set-point at a past or future time of the running trajectory."""
        tick = message_time_ns(request.time) / self._tick_ns
        response.name = self._names
        present = self._loop.state
        reason = present.switch.refusal or ("" if present.started else "no states have come yet")
        try:
            (state, moving) = self._loop.query(tick)
        except TrajectoryError as error:
            response.message = reason or str(error)
            return response
        response.position, response.velocity, response.acceleration = state.tolist()
        if not moving:
            reason = (
                reason
                or f"time {tick * self._tick_ns * 1e-9:.6g} s; accepted: up to the end of the motion"
            )
        response.success = not reason
        response.message = reason
        return response

    # What clients get.

    def _finish(self, handle: ServerGoalHandle, goal: TrajectoryRequest) -> None:
        """Send the result of a goal."""
        ends = {
            State.SUCCEEDED: handle.succeed,
            State.ABORTED: handle.abort,
            State.CANCELED: handle.canceled,
        }

        def end(_: ServerGoalHandle) -> Any:
            ends[goal.state]()
            return FollowJointTrajectory.Result(error_code=int(goal.code), error_string=goal.reason)

        self._server.finish(handle, end)
        name = bytes(handle.goal_id.uuid)
        self._goals.pop(name)
        if not self._ending:
            self._result_requested.discard(name)

    def _send_feedback(self, handle: ServerGoalHandle, feedback: Feedback) -> None:
        message = FollowJointTrajectory.Feedback(
            header=Header(stamp=ros_time(feedback.tick * self._tick_ns)),
            joint_names=self._names,
            desired=_point(feedback.desired, feedback.desired_time),
            actual=_point(feedback.actual, feedback.actual_time),
            error=_point(feedback.desired - feedback.actual, feedback.desired_time),
        )
        handle.publish_feedback(message)

    def publish_state(self, stamp_ns: int) -> None:
        """Publish the results of the position loop, if it is time to and there is a subscriber."""
        if stamp_ns % self._state_ns or not self.publisher.get_subscription_count():
            return
        cs7b = self._cs7b
        tick = cs7b.position_tick - 1
        (since, last) = cs7b.trajectory.progress(tick)
        scaling = cs7b.trajectory.speed_scaling(tick)
        since_ns = round(min(max(since, 0.0), last) * NANOSECONDS)
        measured = np.array(cs7b.measured())
        torque = cs7b.tracking_error()[2]
        self.publisher.publish(
            self._state.encode(stamp_ns, since_ns, cs7b.setpoint, measured, torque, scaling)
        )


def _point(state: Array, seconds: float) -> JointTrajectoryPoint:
    sec, nanosec = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    position, velocity, acceleration = state.tolist()
    return JointTrajectoryPoint(
        positions=position,
        velocities=velocity,
        accelerations=acceleration,
        time_from_start=Duration(sec=sec, nanosec=nanosec),
    )


class _StateMessage:
    """JointTrajectoryControllerState as CDR bytes whose numbers are written in place.

    To fill and serialise a message in Python takes longer than a tick. Alignment padding is written as zeros, so that
    equal values give equal bytes; the serialiser of rclpy leaves there whatever was in memory.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        body = CdrBody()
        joints = len(joint_names)
        stamp = body.zeros(8)
        body.string("")  # frame_id
        body.strings(joint_names)
        numbers = []
        times = []
        for rows in _POINT_ROWS:
            for there in rows:
                body.count(joints if there else 0)
                if there:
                    body.align(8)
                    numbers.append(body.zeros(8 * joints))
            times.append(body.zeros(8))
        body.strings([])
        for _ in range(_OF_SEVERAL_AXES):
            for _ in range(3):
                body.count(0)
            body.zeros(8)
        body.align(8)
        scaling = body.zeros(8)
        self._raw = raw = body.message()

        def view(kind: str, at: int, size: int) -> NDArray[Any]:
            return np.frombuffer(raw, kind, size, ENCAPSULATION + at)

        self._stamp = view("<i4", stamp, 2)  # seconds and nanoseconds, as the times from the start
        self._times = [view("<i4", at, 2) for at in times[:2]]  # of reference and feedback
        self._rows = [view("<f8", at, joints) for at in numbers]
        self._scaling = view("<f8", scaling, 1)

    def encode(
        self,
        stamp_ns: int,
        since_ns: int,
        setpoint: Array,
        measured: Array,
        torque: Array,
        scaling: float,
    ) -> bytes:
        """Return the message: set-points (3, n), measured positions and velocities (2, n), commanded torques (n,)."""
        self._stamp[:] = divmod(stamp_ns, NANOSECONDS)
        for from_start in self._times:
            from_start[:] = divmod(since_ns, NANOSECONDS)
        for row, values in zip(
            self._rows, (*setpoint, *measured, *(setpoint[:2] - measured), torque), strict=True
        ):
            row[:] = values
        self._scaling[:] = scaling
        return bytes(self._raw)
