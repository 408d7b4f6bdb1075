"""The service ~/query_state; to be imported where control_msgs is."""

from __future__ import annotations

from control_msgs.srv import QueryTrajectoryState
from rclpy.node import Node

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.qos import REQUEST_QOS
from rx90_controller.law.cs7b import CS7B
from rx90_controller.node.servo_loop import ServoLoop


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
        with self._loop.between_ticks() as goals:
            reason = self._loop.inactive or ("" if self._loop.running else "no states have come yet")
            try:
                state, moving = goals.state(tick)
            except TrajectoryError as error:
                response.message = reason or str(error)
                return response
        response.position, response.velocity, response.acceleration = state.tolist()
        if not moving:
            reason = reason or f"time {tick * self._tick_ns * 1e-9:.6g} s; accepted: up to the end of the motion"
        response.success, response.message = not reason, reason
        return response
