"""The action FollowJointTrajectory of the controller node; to be imported where control_msgs is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.message_times import ros_time
from rx90_common.exchange.qos import REQUEST_QOS
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.trajectory.request import Feedback, Outcome, State, TrajectoryRequest

_WATCH_PERIOD = 0.5  # s between two looks for the simulation, while there is a goal
_SIMULATION_TIMEOUT = 2.0  # s without one, after which the goal is given up
_RESULT_KEPT = 60.0  # s for which results are kept for clients that ask late; a goal may be large
_RESULT_GRACE = 2.0  # s in which the client of the last goal may ask for its result
_FLUSH_SPINS, _SPIN_TIMEOUT = 10, 0.01  # turns of the executor in which a result is sent, and s of each at the most
_ENDS = "the controller ends"


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


class _GoalClient:
    """Who sent a goal: gets feedback and result by the goal's handle.

    Attributes:
        asked: whether the client has asked for the result.
    """

    def __init__(self, action: FollowJointTrajectoryAction, handle: ServerGoalHandle, goal: TrajectoryRequest) -> None:
        self._action, self.handle, self.goal = action, handle, goal
        self.asked = False

    def on_feedback(self, feedback: Feedback) -> None:
        """Send feedback."""
        self.handle.publish_feedback(self._action.feedback_message(feedback))

    def on_result(self, outcome: Outcome) -> None:
        """Send the result."""
        self._action.finish(self, outcome)


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
        self._clients: dict[bytes, _GoalClient] = {}  # of the goals that may still be cancelled
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
        with self._checking, self._loop.between_ticks() as requests:
            self._ending, ending = True, list(self._clients.values())
            requests.drop(_ENDS)
        self._loop.report()
        executor, until, spins = self._node.executor, time.monotonic() + _RESULT_GRACE, _FLUSH_SPINS
        # A client that asked while another goal was checked has not been answered yet.
        while executor is not None and spins > 0:
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT if ending else 0.0)
            answered = all(client.asked and not client.handle.is_active for client in ending)
            if answered or time.monotonic() > until:
                spins -= 1

    def close(self) -> None:
        """Serve no more goals; those that there were have ended."""
        self._server.destroy()

    # Requests of clients, in the order in which they come.

    def _on_goal(self, message: Any) -> GoalResponse:
        """Check a goal."""
        with self._checking:
            missing = "" if self._simulation_there() else "there is no simulation; accepted: once there is one"
            self._checked = self._loop.receive_goal(message, _ENDS if self._ending else missing)
        return GoalResponse.REJECT if self._checked is None else GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        """Follow the goal that was checked just before, once its client has got the answer."""
        with self._checking:
            goal = self._checked
            assert goal is not None
            handle.execute()
            goal.client = self._clients[bytes(handle.goal_id.uuid)] = _GoalClient(self, handle, goal)
            self._loop.offer(goal)
            if self._ending:
                with self._loop.between_ticks() as requests:
                    requests.drop(_ENDS)

    def _on_result_request(self, name: bytes) -> None:
        if name in self._clients:
            self._clients[name].asked = True

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Cancel a goal; where its end is on the way already, its client gets that."""
        client = self._clients.get(bytes(handle.goal_id.uuid))
        if client is not None:
            with self._loop.between_ticks() as requests:
                requests.cancel(client.goal)
        return CancelResponse.ACCEPT

    def _watch_simulation(self) -> None:
        """Give the goal up whose simulation is gone."""
        now = time.monotonic()
        with self._loop.between_ticks() as requests:
            if not requests.pending or self._simulation_there():
                self._seen = now
            elif now - self._seen > _SIMULATION_TIMEOUT:
                requests.drop(f"the simulation is gone, for more than {_SIMULATION_TIMEOUT:g} s", halt=True)

    # What clients get.

    def finish(self, client: _GoalClient, outcome: Outcome) -> None:
        """Send a client the result of its goal."""

        def end(handle: ServerGoalHandle) -> Any:
            {State.SUCCEEDED: handle.succeed, State.ABORTED: handle.abort, State.CANCELED: handle.canceled}[
                outcome.state
            ]()
            return FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.text)

        self._server.finish(client.handle, end)
        self._clients.pop(bytes(client.handle.goal_id.uuid))

    def feedback_message(self, feedback: Feedback) -> Any:
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
