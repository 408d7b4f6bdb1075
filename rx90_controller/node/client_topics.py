"""Topics and services of joint_trajectory_controller beside its action; to be imported where control_msgs is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor
from control_msgs.srv import QueryTrajectoryState
from numpy.typing import NDArray
from rclpy.node import Node

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.stamps import ENCAPSULATION, message_time_ns
from rx90_common.exchange.cdr import CdrBody
from rx90_common.exchange.endpoints import LATCHED_QOS, REQUEST_QOS, STATE_QOS, publish, subscribe
from rx90_common.exchange.pacing import ThrottledLog
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop

_FIELDS = ("positions", "velocities", "accelerations", "effort")
_POINTS = {
    "reference": ("positions", "velocities", "accelerations"),
    "feedback": ("positions", "velocities"),
    "error": ("positions", "velocities"),
    "output": ("effort",),
}
"""The points of the message, and what each of them has."""
_OF_SEVERAL_AXES = 4  # points of joints that the arm has not, of three empty sequences and a time each


class SpeedScaling:
    """Follows trajectories at the share of their speed that is asked for, also while one runs."""

    def __init__(self, node: Node, loop: ServoLoop) -> None:
        self._loop, self._log = loop, node.get_logger()
        self._said: float | None = None
        # Some repeat theirs hundreds of times a second, right or wrong.
        self._complaints = ThrottledLog(lambda text: node.get_logger().error(text))
        # As the original has it: who asked before this node was there is heard, too.
        subscribe(node, SpeedScalingFactor, "~/speed_scaling_input", self._on_factor, LATCHED_QOS.profile)

    def _on_factor(self, message: SpeedScalingFactor) -> None:
        try:
            with self._loop.between_ticks() as requests:
                requests.scale(message.factor)
        except TrajectoryError as error:
            self._complaints.say("factor", f"{error}; ignored")
        else:
            if message.factor != self._said:
                self._log.info(f"speed scaling {message.factor:g}")
                self._said = message.factor


class StateQuery:
    """Answers what the set-point was, or will be, at a time of the running trajectory."""

    def __init__(self, node: Node, loop: ServoLoop, cs7b: CS7B) -> None:
        self._loop, self._cs7b = loop, cs7b
        self._tick_ns = cs7b.rates.period_ns * cs7b.rates.ratio
        self._service = node.create_service(
            QueryTrajectoryState, "~/query_state", self._answer, qos_profile=REQUEST_QOS.profile
        )

    def _answer(
        self, request: QueryTrajectoryState.Request, response: QueryTrajectoryState.Response
    ) -> QueryTrajectoryState.Response:
        tick = message_time_ns(request.time) / self._tick_ns
        response.name = list(self._cs7b.joint_names)
        with self._loop.between_ticks() as requests:
            reason = self._loop.inactive or ("" if self._loop.running else "no states have come yet")
            try:
                state, moving = requests.state(tick)
            except TrajectoryError as error:
                response.message = reason or str(error)
                return response
        response.position, response.velocity, response.acceleration = state.tolist()
        if not moving:
            reason = reason or f"time {tick * self._tick_ns * 1e-9:.6g} s; accepted: up to the end of the motion"
        response.success, response.message = not reason, reason
        return response


class ControllerState:
    """Set-points, measured joints, their difference and the commanded torques, a few times a second.

    Attributes:
        publisher: to look at what it is matched with.
        period_ns: from one message to the next.
    """

    def __init__(self, node: Node, cs7b: CS7B, state_ticks: int) -> None:
        """Publish every `state_ticks` position ticks."""
        self._cs7b = cs7b
        self._message = StateMessage(cs7b.joint_names)
        self.publisher = publish(node, JointTrajectoryControllerState, "~/controller_state", STATE_QOS.profile)
        self.period_ns = cs7b.rates.period_ns * cs7b.rates.ratio * state_ticks

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left, if somebody listens."""
        if not self.publisher.get_subscription_count():
            return
        cs7b, message, numbers = self._cs7b, self._message, self._message.numbers
        tick = cs7b.position_tick - 1
        progress = cs7b.trajectory.progress(tick)
        since = round(min(max(progress.time, 0.0), progress.last) * NANOSECONDS)
        message.stamp[:] = divmod(stamp_ns, NANOSECONDS)
        for time in message.times:
            time[:] = divmod(since, NANOSECONDS)
        fields = ("positions", "velocities", "accelerations")
        measured = cs7b.measured()
        for row, field in enumerate(fields):
            numbers["reference", field][:] = cs7b.setpoint[row]
        for row, field in enumerate(fields[:2]):
            numbers["feedback", field][:] = measured[row]
            numbers["error", field][:] = cs7b.setpoint[row] - measured[row]
        numbers["output", "effort"][:] = cs7b.tracking_error()[2]
        message.scaling[0] = cs7b.trajectory.speed_scaling(tick)
        self.publisher.publish(message.encode())


class StateMessage:
    """JointTrajectoryControllerState as CDR bytes whose numbers are written in place.

    To fill and serialise a message in Python takes longer than a tick. Alignment padding is written as zeros, so that
    equal values give equal bytes; the serialiser of rclpy leaves there whatever was in memory.

    Attributes:
        stamp: seconds and nanoseconds of the header, shape (2,).
        times: time_from_start of reference and feedback, s and ns, shape (2,) each.
        numbers: by point and field, in the order of the joints, shape (n,) each.
        scaling: speed_scaling_factor, shape (1,).
    """

    def __init__(self, names: Sequence[str]) -> None:
        body = CdrBody()
        stamp = body.zeros(8)
        body.string("")  # frame_id
        body.strings(names)
        numbers, times = {}, []
        for point, given in _POINTS.items():
            for field in _FIELDS:
                body.count(len(names) if field in given else 0)
                if field in given:
                    body.align(8)
                    numbers[point, field] = body.zeros(8 * len(names))
            times.append(body.zeros(8))
        body.strings([])
        for _ in range(_OF_SEVERAL_AXES):
            for _ in range(3):
                body.count(0)
            body.zeros(8)
        body.align(8)
        scaling = body.zeros(8)

        self._raw = body.message()

        def part(kind: str, at: int, size: int) -> NDArray[Any]:
            return np.frombuffer(self._raw, kind, size, ENCAPSULATION + at)

        self.stamp = part("<i4", stamp, 2)
        self.times = [part("<i4", at, 2) for at in times[:2]]
        self.numbers = {key: part("<f8", at, len(names)) for key, at in numbers.items()}
        self.scaling = part("<f8", scaling, 1)

    def encode(self) -> bytes:
        """Return the message as it is now."""
        return bytes(self._raw)
