"""The action FollowJointTrajectory of the controller node; to be imported where control_msgs is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS, Rates
from rx90_common.exchange.endpoints import REQUEST_QOS, ros_time
from rx90_controller.goals.execution import Feedback, Outcome, Phase
from rx90_controller.goals.request import GoalError, ResultCode, TrajectoryRequest, check_goal
from rx90_controller.node.servo_loop import ServoLoop

_LOOK = 0.5  # s between two looks for the simulation, while there is a goal
_SIMULATION_TIMEOUT = 2.0  # s without one, after which the goal is given up
_KEPT = 60.0  # s for which results are kept for clients that ask late; a goal may be large
_RESULT_GRACE = 2.0  # s in which the client of the last goal may ask for its result
_TURNS, _TURN = 10, 0.01  # turns of the executor in which a result is sent, and s of each at the most
_ENDS = "the controller ends"


class _Server(ActionServer):
    """rclpy's server, for goals that others execute and that have ended when it is told.

    Its own way is a function that runs while a goal does: it would keep the executor, or, if it waits for something,
    be called again and again, which takes a whole core (rclpy 7).
    """

    heard: Callable[[bytes], object]

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Serve requests, and note the goal whose result is asked for."""
        await super().execute(taken_data)
        if "result" in taken_data:
            self.heard(bytes(taken_data["result"][1].goal_id.uuid))

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None) -> None:
        """Do nothing: the goal is executed by the thread that ticks."""

    def finish(self, handle: ServerGoalHandle, end: Callable[[ServerGoalHandle], Any]) -> None:
        """Send the result that `end` returns once it has given the goal its last state."""
        super().notify_execute(handle, end)


class _Sender:
    """One goal's way back to who has sent it.

    Args:
        server: that has the goal.
        handle: of the goal.
        feedback: makes the action's feedback.
        forget: called once the result is sent.

    Attributes:
        asked: whether the client has asked for the result.
    """

    def __init__(
        self,
        server: _Server,
        handle: ServerGoalHandle,
        feedback: Callable[[Feedback], Any],
        forget: Callable[[], object],
    ) -> None:
        self._server, self._handle, self._feedback, self._forget = server, handle, feedback, forget
        self.asked = False

    @property
    def answered(self) -> bool:
        """Return whether the goal has ended, and its client has asked how."""
        return self.asked and not self._handle.is_active

    def on_feedback(self, feedback: Feedback) -> None:
        """Send feedback."""
        self._handle.publish_feedback(self._feedback(feedback))

    def on_result(self, outcome: Outcome) -> None:
        """Send the result."""
        self._server.finish(self._handle, partial(_end, outcome))
        self._forget()


def _end(outcome: Outcome, handle: ServerGoalHandle) -> Any:
    """Give a goal its last state and return its result."""
    {Phase.SUCCEEDED: handle.succeed, Phase.ABORTED: handle.abort, Phase.CANCELED: handle.canceled}[outcome.phase]()
    return result_message(outcome)


class FollowJointTrajectoryAction:
    """The action server: goals are checked and answered on the executor's thread, and followed by the one that ticks.

    What can be seen by a goal itself, and what is sent to a controller that is not active, is rejected. What depends on
    where the arm then is (start, limits) is accepted and aborted at once: a result has a text, a rejection has none.

    Args:
        node: whose action it is.
        loop: follows the goals.
        names: of the joints.
        rates: of the loops.
        simulation_there: tells whether there is a simulation.
    """

    def __init__(
        self,
        node: Node,
        loop: ServoLoop,
        names: Sequence[str],
        rates: Rates,
        simulation_there: Callable[[], bool],
    ) -> None:
        self._names = names
        self._node, self._loop, self._simulation_there = node, loop, simulation_there
        self._position_hz = rates.position_hz
        self._feedback = partial(feedback_message, names=names, tick_ns=rates.period_ns * rates.ratio)
        self._senders: dict[bytes, _Sender] = {}  # of the goals that a client may still cancel
        self._checked: TrajectoryRequest | None = None  # the goal that is accepted next
        self._checking = threading.Lock()  # an executor of several threads goes on while the node ends
        self._ending = False
        self._seen = time.monotonic()  # when the simulation was there
        self._server = _Server(
            node,
            FollowJointTrajectory,
            "~/follow_joint_trajectory",
            execute_callback=_end,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            goal_service_qos_profile=REQUEST_QOS.profile,
            result_service_qos_profile=REQUEST_QOS.profile,
            cancel_service_qos_profile=REQUEST_QOS.profile,
            result_timeout=_KEPT,
        )
        self._server.heard = self._on_asked
        self._timer = node.create_timer(_LOOK, self._look)

    def end(self) -> None:
        """End the active goal because the node ends, and send its result; take no other."""
        with self._checking, self._loop.between_ticks() as requests:
            self._ending, ending = True, list(self._senders.values())
            requests.drop(_ENDS)
        self._loop.report()
        executor, until, turns = self._node.executor, time.monotonic() + _RESULT_GRACE, _TURNS
        # A client that asked while another goal was checked has not been heard yet.
        while executor is not None and turns > 0:
            executor.spin_once(timeout_sec=_TURN if ending else 0.0)
            if time.monotonic() > until or all(sender.answered for sender in ending):
                turns -= 1

    def close(self) -> None:
        """Serve no more goals; those that there were have ended."""
        self._server.destroy()

    # Requests of clients, in the order in which they come.

    def _on_goal(self, message: Any) -> GoalResponse:
        """Check a goal."""
        with self._checking:
            return self._check(message)

    def _check(self, message: Any) -> GoalResponse:
        loop = self._loop
        with loop.between_ticks() as requests:
            options, tolerances = requests.options, requests.tolerances
        try:
            if self._ending:
                raise GoalError(ResultCode.INVALID_GOAL, _ENDS)
            # Not between two ticks: a long one takes longer than these.
            goal = check_goal(message, self._names, tolerances, options, self._position_hz)
            with loop.between_ticks() as requests:
                requests.check(goal, loop.inactive or self._missing())
        except GoalError as error:
            with loop.between_ticks() as requests:
                requests.refused("goal", error)
            return GoalResponse.REJECT
        self._checked = goal
        return GoalResponse.ACCEPT

    def _missing(self) -> str:
        return "" if self._simulation_there() else "there is no simulation; accepted: once there is one"

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        """Follow the goal that was checked just before, once its client has got the answer."""
        with self._checking:
            self._follow(handle)

    def _follow(self, handle: ServerGoalHandle) -> None:
        loop, goal = self._loop, self._checked
        assert goal is not None
        handle.execute()
        name = bytes(handle.goal_id.uuid)
        sender = _Sender(self._server, handle, self._feedback, partial(self._senders.pop, name))
        self._senders[name] = sender
        with loop.joined(goal) as (requests, plan):
            if loop.running:
                requests.take(goal, loop.inactive, plan, sender)
            else:
                requests.wait(goal, sender)
            if self._ending:
                requests.drop(_ENDS)

    def _on_asked(self, name: bytes) -> None:
        sender = self._senders.get(name)
        if sender is not None:
            sender.asked = True

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """Cancel a goal; where its end is on the way already, its client gets that."""
        sender = self._senders.get(bytes(handle.goal_id.uuid))
        if sender is not None:
            with self._loop.between_ticks() as requests:
                requests.cancel(sender)
        return CancelResponse.ACCEPT

    def _look(self) -> None:
        """Give the goal up whose simulation is gone."""
        now = time.monotonic()
        with self._loop.between_ticks() as requests:
            if not requests.pending or self._simulation_there():
                self._seen = now
            elif now - self._seen > _SIMULATION_TIMEOUT:
                requests.drop(f"the simulation is gone, for more than {_SIMULATION_TIMEOUT:g} s", halt=True)


def feedback_message(feedback: Feedback, names: Sequence[str], tick_ns: int) -> Any:
    """Return a FollowJointTrajectory.Feedback; `tick_ns` is the period of the position loop."""
    return FollowJointTrajectory.Feedback(
        header=Header(stamp=ros_time(feedback.tick * tick_ns)),
        joint_names=list(names),
        desired=_point(feedback.desired, feedback.desired_time),
        actual=_point(feedback.actual, feedback.actual_time),
        error=_point(feedback.error, feedback.desired_time),
    )


def result_message(outcome: Outcome) -> Any:
    """Return a FollowJointTrajectory.Result."""
    return FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.text)


def _point(state: Array, seconds: float) -> JointTrajectoryPoint:
    sec, nanosec = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    position, velocity, acceleration = state.tolist()
    return JointTrajectoryPoint(
        positions=position,
        velocities=velocity,
        accelerations=acceleration,
        time_from_start=Duration(sec=sec, nanosec=nanosec),
    )
