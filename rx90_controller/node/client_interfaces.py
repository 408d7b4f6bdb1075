"""What clients of joint_trajectory_controller meet: the action FollowJointTrajectory, topics and a service beside it.

To be imported where control_msgs is.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
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
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, message_time_ns
from rx90_common.exchange.cdr import CdrBody
from rx90_common.exchange.endpoints import LATCHED_QOS, REQUEST_QOS, STATE_QOS, publish, ros_time, subscribe
from rx90_common.exchange.pacing import ThrottledLog
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.trajectory.request import Feedback, State, TrajectoryRequest

_WATCH_PERIOD = 0.5  # s between two looks for the simulation, while there is a goal
_SIMULATION_TIMEOUT = 2.0  # s without one, after which the goal is given up
_RESULT_KEPT = 60.0  # s for which results are kept for clients that ask late; a goal may be large
_RESULT_GRACE = 2.0  # s in which the client of the last goal may ask for its result
_FLUSH_SPINS, _SPIN_TIMEOUT = 10, 0.01  # turns of the executor in which a result is sent, and s of each at the most
_ENDS = "the controller ends"
_MOTION = ("positions", "velocities", "accelerations")
_POINTS = {"reference": _MOTION, "feedback": _MOTION[:2], "error": _MOTION[:2], "output": ("effort",)}
"""The points of the controller's state, and what each of them has."""
_OF_SEVERAL_AXES = 4  # points of joints that the arm has not, of three empty sequences and a time each


class _Server(ActionServer):
    """rclpy's server, for goals that others execute and that have ended when it learns of their end.

    Its own way is a function that runs while a goal does: it would keep the executor, or, if it waits for something,
    be called again and again, which takes a whole core (rclpy 7).
    """

    on_result_request: Callable[[bytes], object]

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Serve requests, and note the goal whose result is asked for."""
        await super().execute(taken_data)
        if "result" in taken_data:
            self.on_result_request(bytes(taken_data["result"][1].goal_id.uuid))

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None) -> None:
        """Do nothing: the goal is executed by the thread that ticks."""

    def finish(self, handle: ServerGoalHandle, end: Callable[[ServerGoalHandle], Any]) -> None:
        """Send the result that `end` returns once it has given the goal its last state."""
        super().notify_execute(handle, end)


class FollowJointTrajectoryAction:
    """The action server: goals are checked and answered on the executor's thread, and followed by the one that ticks.

    What can be seen by a goal itself, and what is sent to a controller that is not active, is rejected. What depends on
    where the arm then is (start, limits) is accepted and aborted at once: a result has a text, a rejection has none.

    Args:
        node: whose action it is.
        loop: follows the goals.
        cs7b: of the loop.
        simulation_there: returns whether there is a simulation.
    """

    def __init__(self, node: Node, loop: ServoLoop, cs7b: CS7B, simulation_there: Callable[[], bool]) -> None:
        self._node, self._loop, self._simulation_there = node, loop, simulation_there
        self._names, self._tick_ns = list(cs7b.joint_names), cs7b.rates.period_ns * cs7b.rates.ratio
        self._goals: dict[bytes, TrajectoryRequest] = {}  # that may still be cancelled
        self._asked: set[bytes] = set()  # goals whose client has asked for the result
        self._checked: TrajectoryRequest | None = None  # the goal that is accepted next
        self._checking = threading.Lock()  # an executor of several threads goes on while the node ends
        self._ending = False
        self._seen = time.monotonic()  # when the simulation was there
        self._server = _Server(
            node,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=lambda _: None,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            goal_service_qos_profile=REQUEST_QOS.profile,
            result_service_qos_profile=REQUEST_QOS.profile,
            cancel_service_qos_profile=REQUEST_QOS.profile,
            result_timeout=_RESULT_KEPT,
        )
        self._server.on_result_request = self._on_result_request
        node.create_timer(_WATCH_PERIOD, self._watch_simulation)

    def end(self) -> None:
        """End the active goal because the node ends, and send its result; take no other."""
        with self._checking:
            self._ending, ending = True, set(self._goals)
            self._loop.drop(_ENDS)
        self._loop.report()
        executor, until, spins = self._node.executor, time.monotonic() + _RESULT_GRACE, _FLUSH_SPINS
        # A client that asked while another goal was checked has not been answered yet.
        while executor is not None and spins > 0:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT if ending else 0.0)
            if (ending <= self._asked and not self._goals) or time.monotonic() > until:
                spins -= 1

    def close(self) -> None:
        """Serve no more goals; those that there were have ended."""
        self._server.destroy()

    # Requests of clients, in the order in which they come.

    def _on_goal(self, message: Any) -> GoalResponse:
        """Check a goal."""
        with self._checking:
            missing = "" if self._simulation_there() else "there is no simulation; accepted: once there is one"
            self._checked = self._loop.receive(message.trajectory, message, _ENDS if self._ending else missing)
        return GoalResponse.REJECT if self._checked is None else GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        """Follow the goal that was checked just before, once its client has got the answer."""
        with self._checking:
            goal = self._checked
            assert goal is not None
            handle.execute()
            goal.on_feedback = lambda feedback: handle.publish_feedback(self._feedback_message(feedback))
            goal.on_result = partial(self._finish, handle, goal)
            self._goals[bytes(handle.goal_id.uuid)] = goal
            self._loop.offer(goal)
            if self._ending:
                self._loop.drop(_ENDS)

    def _on_result_request(self, name: bytes) -> None:
        if name in self._goals or self._ending:
            self._asked.add(name)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Cancel a goal; where its end is on the way already, its client gets that."""
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is not None:
            self._loop.cancel(goal)
        return CancelResponse.ACCEPT

    def _watch_simulation(self) -> None:
        """Give the goal up whose simulation is gone."""
        now = time.monotonic()
        if not self._loop.has_goal or self._simulation_there():
            self._seen = now
        elif now - self._seen > _SIMULATION_TIMEOUT:
            self._loop.drop(f"the simulation is gone, for more than {_SIMULATION_TIMEOUT:g} s", halt=True)

    # What clients get.

    def _finish(self, handle: ServerGoalHandle, goal: TrajectoryRequest) -> None:
        """Send the result of a goal."""
        ends = {State.SUCCEEDED: handle.succeed, State.ABORTED: handle.abort, State.CANCELED: handle.canceled}

        def end(_: ServerGoalHandle) -> Any:
            ends[goal.state]()
            return FollowJointTrajectory.Result(error_code=int(goal.code), error_string=goal.reason)

        self._server.finish(handle, end)
        name = bytes(handle.goal_id.uuid)
        self._goals.pop(name)
        if not self._ending:
            self._asked.discard(name)

    def _feedback_message(self, feedback: Feedback) -> Any:
        """Return a FollowJointTrajectory.Feedback."""
        return FollowJointTrajectory.Feedback(
            header=Header(stamp=ros_time(feedback.tick * self._tick_ns)),
            joint_names=self._names,
            desired=_point(feedback.desired, feedback.desired_time),
            actual=_point(feedback.actual, feedback.actual_time),
            error=_point(feedback.error, feedback.desired_time),
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


def serve_clients(
    node: Node, loop: ServoLoop, cs7b: CS7B, simulation_there: Callable[[], bool]
) -> FollowJointTrajectoryAction:
    """Serve the action, which is returned, `query_state`, and speed scaling; the arguments are the action's."""
    _serve_speed_scaling(node, loop, cs7b)
    _serve_state_query(node, loop, cs7b)
    return FollowJointTrajectoryAction(node, loop, cs7b, simulation_there)


def _serve_speed_scaling(node: Node, loop: ServoLoop, cs7b: CS7B) -> None:
    """Follow trajectories at the share of their speed that is asked for, also while one runs."""
    log, announced = node.get_logger(), None
    # Some repeat theirs hundreds of times a second, right or wrong.
    complaints = ThrottledLog(lambda text: node.get_logger().error(text))

    def on_factor(message: SpeedScalingFactor) -> None:
        nonlocal announced
        try:
            with loop.between_ticks():
                cs7b.trajectory.set_speed_scaling(message.factor, cs7b.position_tick)
        except TrajectoryError as error:
            complaints.say("factor", f"{error}; ignored")
        else:
            if message.factor != announced:
                log.info(f"speed scaling {message.factor:g}")
                announced = message.factor

    # Latched, as the original has it: what was asked for before this node was there counts, too.
    subscribe(node, SpeedScalingFactor, "~/speed_scaling_input", on_factor, LATCHED_QOS.profile)


def _serve_state_query(node: Node, loop: ServoLoop, cs7b: CS7B) -> None:
    """Answer what the set-point was, or will be, at a time of the running trajectory."""
    trajectory, tick_ns = cs7b.trajectory, cs7b.rates.period_ns * cs7b.rates.ratio

    def answer(
        request: QueryTrajectoryState.Request, response: QueryTrajectoryState.Response
    ) -> QueryTrajectoryState.Response:
        tick = message_time_ns(request.time) / tick_ns
        response.name = list(cs7b.joint_names)
        with loop.between_ticks():
            reason = loop.inactive or ("" if loop.running else "no states have come yet")
            try:
                state, moving = trajectory.state(tick), trajectory.moving(math.ceil(tick) - 1)
            except TrajectoryError as error:
                response.message = reason or str(error)
                return response
        response.position, response.velocity, response.acceleration = state.tolist()
        if not moving:
            reason = reason or f"time {tick * tick_ns * 1e-9:.6g} s; accepted: up to the end of the motion"
        response.success, response.message = not reason, reason
        return response

    node.create_service(QueryTrajectoryState, "~/query_state", answer, qos_profile=REQUEST_QOS.profile)


class ControllerState:
    """Set-points, measured joints, their difference and the commanded torques, a few times a second.

    JointTrajectoryControllerState is sent as CDR bytes whose numbers are written in place: to fill and serialise a
    message in Python takes longer than a tick. Alignment padding is written as zeros, so that equal values give equal
    bytes; the serialiser of rclpy leaves there whatever was in memory.

    Args:
        node: the publisher's.
        cs7b: whose state it is.
        state_ticks: position ticks from one message to the next.

    Attributes:
        publisher: to look at what it is matched with.
        period_ns: from one message to the next.
    """

    def __init__(self, node: Node, cs7b: CS7B, state_ticks: int) -> None:
        self._cs7b = cs7b
        self.publisher = publish(node, JointTrajectoryControllerState, "~/controller_state", STATE_QOS.profile)
        self.period_ns = cs7b.rates.period_ns * cs7b.rates.ratio * state_ticks
        body, joints = CdrBody(), len(cs7b.joint_names)
        stamp = body.zeros(8)
        body.string("")  # frame_id
        body.strings(cs7b.joint_names)
        numbers, times = {}, []
        for point, given in _POINTS.items():
            for name in (*_MOTION, "effort"):
                body.count(joints if name in given else 0)
                if name in given:
                    body.align(8)
                    numbers[point, name] = body.zeros(8 * joints)
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
        self._numbers = {key: view("<f8", at, joints) for key, at in numbers.items()}
        self._scaling = view("<f8", scaling, 1)

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left, if somebody listens."""
        if not self.publisher.get_subscription_count():
            return
        cs7b, numbers = self._cs7b, self._numbers
        tick = cs7b.position_tick - 1
        progress = cs7b.trajectory.progress(tick)
        since = round(min(max(progress.time, 0.0), progress.last) * NANOSECONDS)
        self._stamp[:] = divmod(stamp_ns, NANOSECONDS)
        for from_start in self._times:
            from_start[:] = divmod(since, NANOSECONDS)
        measured = cs7b.measured()
        for row, name in enumerate(_MOTION):
            numbers["reference", name][:] = cs7b.setpoint[row]
            if row < len(measured):
                numbers["feedback", name][:] = measured[row]
                numbers["error", name][:] = cs7b.setpoint[row] - measured[row]
        numbers["output", "effort"][:] = cs7b.tracking_error()[2]
        self._scaling[:] = cs7b.trajectory.speed_scaling(tick)
        self.publisher.publish(bytes(self._raw))
