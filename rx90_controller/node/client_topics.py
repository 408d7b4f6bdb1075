"""Topics and services of joint_trajectory_controller beside its action; to be imported where control_msgs is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
from control_msgs.srv import QueryTrajectoryState
from numpy.typing import NDArray
from rclpy.node import Node

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, message_time_ns
from rx90_common.exchange.cdr_body import CdrBody
from rx90_common.exchange.qos import LATCHED_QOS, REQUEST_QOS, STATE_QOS
from rx90_common.exchange.qos_overrides import publish
from rx90_common.exchange.subscribing import subscribe
from rx90_common.exchange.throttle import ThrottledLog
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop

_MOTION = ("positions", "velocities", "accelerations")
_POINTS = {"reference": _MOTION, "feedback": _MOTION[:2], "error": _MOTION[:2], "output": ("effort",)}
"""The points of the controller's state, and what each of them has."""
_OF_SEVERAL_AXES = 4  # points of joints that the arm has not, of three empty sequences and a time each


class SpeedScaling:
    """Follows trajectories at the share of their speed that is asked for, also while one runs."""

    def __init__(self, node: Node, loop: ServoLoop, cs7b: CS7B) -> None:
        self._loop, self._cs7b, self._log = loop, cs7b, node.get_logger()
        self._announced: float | None = None
        # Some repeat theirs hundreds of times a second, right or wrong.
        self._complaints = ThrottledLog(lambda text: node.get_logger().error(text))
        # Latched, as the original has it: what was asked for before this node was there counts, too.
        subscribe(node, SpeedScalingFactor, "~/speed_scaling_input", self._on_factor, LATCHED_QOS.profile)

    def _on_factor(self, message: SpeedScalingFactor) -> None:
        try:
            with self._loop.between_ticks():
                self._cs7b.trajectory.set_speed_scaling(message.factor, self._cs7b.position_tick)
        except TrajectoryError as error:
            self._complaints.say("factor", f"{error}; ignored")
        else:
            if message.factor != self._announced:
                self._log.info(f"speed scaling {message.factor:g}")
                self._announced = message.factor


def serve_state_query(node: Node, loop: ServoLoop, cs7b: CS7B) -> None:
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
        for time in self._times:
            time[:] = divmod(since, NANOSECONDS)
        measured = cs7b.measured()
        for row, name in enumerate(_MOTION):
            numbers["reference", name][:] = cs7b.setpoint[row]
            if row < len(measured):
                numbers["feedback", name][:] = measured[row]
                numbers["error", name][:] = cs7b.setpoint[row] - measured[row]
        numbers["output", "effort"][:] = cs7b.tracking_error()[2]
        self._scaling[:] = cs7b.trajectory.speed_scaling(tick)
        self.publisher.publish(bytes(self._raw))
