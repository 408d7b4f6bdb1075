"""The controller node: parameters, topics and services around one control law."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.errors import ExchangeError, MessageError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import load_robot
from rx90_common.exchange import node_tools
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.lockstep import LockstepController
from rx90_common.exchange.node_tools import Diagnostics, declare
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.qos import LATCHED_QOS, STATE_QOS, TICK_QOS, TRAJECTORY_QOS
from rx90_common.exchange.throttle import Occasionally
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import FREE_RUNNING, MOTOR_COMMANDS, MOTOR_NAMES, MOTOR_STATES, TIME_MODE
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import load_controller
from rx90_controller.node.free_running import FreeRunningController
from rx90_controller.trajectory.message import points_from_message, start_tick

Array = NDArray[np.float64]

_WAIT_SLICE = 0.1
_MATCH_ATTEMPTS = 100  # of 50 ms


class Control:
    """The node and its ticking thread's loop."""

    def __init__(self) -> None:
        self.node = Node("rx90_controller")
        self._log = self.node.get_logger()
        rates = self._read_rates()
        self._cs7b = self._build(rates)
        self._channel = Channel(self.node, MOTOR_COMMANDS, MOTOR_STATES, TICK_QOS)
        self._states = JointStateCodec(MOTOR_NAMES)
        commands = JointStateCodec(MOTOR_NAMES)
        self._encode_command = commands.encoder(effort=self._cs7b.command)
        self._encode_no_command = commands.encoder()
        joint_states = JointStateCodec(self._cs7b.joint_names)
        self._encode_reference = joint_states.encoder(*self._cs7b.reference())
        self._encode_error = joint_states.encoder(*self._cs7b.tracking_error())
        self._reference = self.node.create_publisher(JointState, "~/reference", STATE_QOS)
        self._error = self.node.create_publisher(JointState, "~/tracking_error", STATE_QOS)
        # Trajectories and switches come on the executor's thread, between ticks.
        self._lock = threading.Lock()
        self._enabled = True
        self._waiting: JointTrajectory | None = None
        self._seen = False
        self._stopped = False
        self._mode: str | None = None
        self._refused: ExchangeError | None = None
        self._complaints = Occasionally(self._log.error)
        self._pacer = Pacer(rates.period, 1.0)
        self._lockstep = LockstepController(self._channel, self._log.info, self._answer, self._begin, rates.period_ns)
        self._free = FreeRunningController(
            self._channel,
            self._pacer,
            self._log.info,
            self._answer,
            self._hold,
            self._wait_for_subscribers,
            self._skip,
            rates,
        )
        self._rejected = 0
        self._reported = (0, time.monotonic())  # tick and time of the last diagnostics
        self.node.create_subscription(String, TIME_MODE, self._on_mode, LATCHED_QOS)
        self.node.create_subscription(JointTrajectory, "~/joint_trajectory", self._on_trajectory, TRAJECTORY_QOS)
        self.node.create_service(SetBool, "~/enable", self._on_enable)
        self._diagnostics = Diagnostics(self.node, self._status)

    def _read_rates(self) -> Rates:
        base = declare(self.node, "base_rate", 4000, "rate of the velocity and current loops, Hz", low=100, high=20000)
        position = declare(self.node, "position_rate", 1000, "rate of the position loop, Hz", low=10, high=20000)
        return Rates(base, position)

    def _build(self, rates: Rates) -> CS7B:
        node = self.node
        urdf = declare(node, "urdf", "robot/rx90b.urdf", "URDF of the arm, for joint names and limits")
        drives = declare(node, "drives", "robot/drives.yaml", "drives file")
        gains = declare(node, "controller", "controller/cs7b.yaml", "file with gains, limits and switches")
        cs7b = CS7B(
            load_robot(resolve_config(urdf)),
            load_drives(resolve_config(drives)),
            load_controller(resolve_config(gains)),
            rates,
        )
        cs7b.warm_up()
        return cs7b

    # The ticking thread.

    def tick_loop(self) -> None:
        """Answer the simulation until `stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        while not self._stopped:
            if self._mode == FREE_RUNNING:
                self._free.serve()
            else:
                self._lockstep.serve(_WAIT_SLICE)
        if self._refused is not None:
            raise self._refused

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self._stopped = True
        self._channel.wake()

    def _begin(self, stamp_ns: int, raw: bytes) -> None:
        """Hold the arm where it is, once the subscribers are there: the states do not follow those seen last."""
        self._decode(raw)
        self._wait_for_subscribers()
        self._hold(stamp_ns, raw)

    def _hold(self, stamp_ns: int, raw: bytes) -> None:
        period = self._cs7b.rates.period_ns
        position, _ = self._decode(raw)
        if stamp_ns < 0 or stamp_ns % period:
            text = (
                f"{self._channel.subscribe_topic} is stamped {stamp_ns} ns; accepted: multiples of {period} ns "
                f"(base_rate {self._cs7b.rates.base_hz} Hz, as the simulation's)"
            )
            if self._mode is None:
                raise ExchangeError(text)
            # The simulation's rates are known to be the same: somebody else sent this.
            self._complaints.say("stamp", f"{text}; ignored")
            raise MessageError(text)
        with self._lock:
            self._cs7b.reset(position, stamp_ns // period)
            self._seen = True
            waiting, self._waiting = self._waiting, None
            if waiting is not None:
                self._accept(waiting)

    def _skip(self, ticks: int, raw: bytes) -> None:
        self._decode(raw)
        with self._lock:
            self._cs7b.skip(ticks)

    def _answer(self, stamp_ns: int, raw: bytes) -> bytes:
        """Run the loops that are due and return the command."""
        position, velocity = self._decode(raw)
        cs7b = self._cs7b
        with self._lock:
            if not self._enabled:
                # A command without torques closes the brakes.
                cs7b.reset(position, stamp_ns // cs7b.rates.period_ns + 1)
                return self._encode_no_command(stamp_ns)
            slow = cs7b.on_position_tick
            cs7b.step(position, velocity)
            # What nobody listens to is not sent: a message costs the tick more than the law.
            if slow and self._reference.get_subscription_count():
                cs7b.reference()
                self._reference.publish(self._encode_reference(stamp_ns))
            if slow and self._error.get_subscription_count():
                cs7b.tracking_error()
                self._error.publish(self._encode_error(stamp_ns))
            return self._encode_command(stamp_ns)

    def _decode(self, raw: bytes) -> tuple[Array, Array]:
        """Return positions and velocities.

        Raises:
            MessageError: if there are none; it has been said.
        """
        try:
            _, position, velocity, _ = self._states.decode(raw)
            if position is None or velocity is None:
                raise ExchangeError("no positions or no velocities; accepted: both")
        except ExchangeError as error:
            text = f"{self._channel.subscribe_topic}: {error}; the message is ignored"
            self._complaints.say("states", text)
            raise MessageError(text) from error
        return position, velocity

    def _wait_for_subscribers(self) -> None:
        publishers = [self._reference, self._error, self._channel.publisher]
        node_tools.wait_until_matched(self.node, publishers, _MATCH_ATTEMPTS)

    # Topics, services and diagnostics, on the executor's thread.

    def _on_mode(self, message: String) -> None:
        try:
            time_mode = TimeMode.parse(message.data)
            time_mode.check(self._cs7b.rates)
        except MessageError as error:
            self._log.error(f"{error}; ignored")
        except ExchangeError as error:
            self._refused = error
            self.stop()
        else:
            self._mode = time_mode.mode
            self._channel.wake()

    def _on_trajectory(self, message: JointTrajectory) -> None:
        with self._lock:
            if not self._seen:
                self._waiting = message
                self._log.info("a trajectory waits for the simulation's first tick")
                return
            self._accept(message)

    def _accept(self, message: JointTrajectory) -> None:
        cs7b = self._cs7b
        try:
            if not self._enabled:
                raise TrajectoryError("the controller is disabled; accepted: after a call of ~/enable with true")
            points = points_from_message(cs7b.joint_names, message)
            start = start_tick(message, cs7b.rates.position_hz)
            begin = cs7b.trajectory.accept(points, cs7b.position_tick, start)
        except TrajectoryError as error:
            self._rejected += 1
            self._log.error(f"trajectory rejected: {error}")
            return
        period = cs7b.rates.position_period
        self._log.info(
            f"trajectory accepted: {len(points.times)} points, {points.times[-1]:.3f} s from {begin * period:.3f} s"
        )

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            self._enabled = request.data
        response.success = True
        response.message = "torque on" if request.data else "torque off, brakes closed"
        self._log.info(response.message)
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        cs7b, counts = self._cs7b, self._pacer.take()
        rates = cs7b.rates
        values = {
            "time mode": self._mode or "unknown: no simulation yet",
            "controller time, s": f"{cs7b.tick * rates.period:.3f}",
            "rate, Hz": f"{self._rate():.1f}",
            "saturated ticks": " ".join(str(n) for n in cs7b.saturated),
            "rejected trajectories": str(self._rejected),
            "enabled": "true" if self._enabled else "false",
        }
        if self._mode == FREE_RUNNING:
            values |= {
                "worst period, ms": f"{counts.worst * 1e3:.3f}",
                "late ticks": str(counts.late),
                "dropped ticks": str(counts.dropped),
            }
        if not self._seen:
            return DiagnosticStatus.WARN, "waiting for the simulation", values
        moving = cs7b.trajectory.moving(cs7b.position_tick)
        return DiagnosticStatus.OK, "following a trajectory" if moving else "holding", values

    def _rate(self) -> float:
        """Return the ticks per second since the last call; 0 over a reset."""
        (tick, at), self._reported = self._reported, (self._cs7b.tick, time.monotonic())
        now_tick, now = self._reported
        return max(0.0, (now_tick - tick) / (now - at))


def spin(args: Sequence[str]) -> None:
    """Run the node until it is interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or a simulation that does not fit.
    """
    node_tools.spin(Control, args)
