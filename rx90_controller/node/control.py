"""The controller node: parameters, topics and services around one control law."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.errors import ExchangeError, MessageError
from rx90_common.base.quoting import one_line, plain
from rx90_common.base.rates import Rates
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange import endpoints
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import MakeChannel, TickChannel
from rx90_common.exchange.endpoints import (
    LATCHED_QOS,
    REQUEST_QOS,
    STATE_QOS,
    TICK_QOS,
    TRAJECTORY_QOS,
    publish,
    ros_time,
    subscribe,
)
from rx90_common.exchange.lifecycle import ManagedNode
from rx90_common.exchange.motor_messages import MotorMessages
from rx90_common.exchange.node_tools import Diagnostics
from rx90_common.exchange.pacing import Pacer, ThrottledLog
from rx90_common.exchange.parameters import declare, declare_rates
from rx90_common.exchange.ros_start import missing_control_msgs
from rx90_common.exchange.topics import (
    DETAIL_DECIMATION,
    DETAILS,
    FREE_RUNNING,
    MOTOR_COMMANDS,
    MOTOR_NAMES,
    MOTOR_STATES,
    TIME_MODE,
    TRAJECTORY_ACCEPTED,
    TimeMode,
)
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.node.parameters import (
    GoalParameters,
    LawParameters,
    allow_goal_changes,
    declare_goal_parameters,
)
from rx90_controller.node.serving import Serving
from rx90_controller.node.servo_loop import INACTIVE, ServoLoop
from rx90_controller.trajectory.message import check_trajectory_bytes

if TYPE_CHECKING:
    from rx90_controller.node.action_server import FollowJointTrajectoryAction
    from rx90_controller.node.client_topics import ControllerState

FILE_PARAMETERS = ("urdf", "drives", "controller")
"""Files of the robot that the node can be given."""
_TRAJECTORY = "~/joint_trajectory"
_MATCH_ATTEMPTS = 100  # of 50 ms


def declare_horizon(node: Node) -> float:
    """Declare, unless it is, and return how far ahead a trajectory may start, s."""
    about = "how far ahead of the controller's own time the stamp of a trajectory may lie, s"
    return declare(node, "start_horizon", 60.0, about, low=0.0, high=1e6)


def declare_decimation(node: Node) -> int:
    """Declare, unless it is, and return how many position ticks there are for each message of DETAILS."""
    about = f"position ticks for each message of {', '.join(f'~/{name}' for name in DETAILS)}"
    return declare(node, "detail_decimation", DETAIL_DECIMATION, about, low=1, high=1_000_000)


class ControllerOutputs:
    """What the loops did, as topics, and lines for the user; called by the ticking thread."""

    def __init__(
        self, node: Node, channel: TickChannel, cs7b: CS7B, robot_name: str, state: ControllerState | None
    ) -> None:
        self._node, self._cs7b, self._state = node, cs7b, state
        self.ready = (
            f"ready: {plain(robot_name)}, velocity loops at {cs7b.rates.base_hz} Hz, position loops at "
            f"{cs7b.rates.position_hz} Hz, states on {channel.subscribe_topic}, trajectories on "
            f"{node.resolve_topic_name(_TRAJECTORY)}"
        )
        codec = JointStateCodec(cs7b.joint_names)
        self._encode_reference = codec.encoder(*cs7b.reference())
        self._encode_error = codec.encoder(*cs7b.tracking_error())
        self._reference = publish(node, JointState, "~/reference", STATE_QOS.profile)
        self._error = publish(node, JointState, "~/tracking_error", STATE_QOS.profile)
        motors = JointStateCodec(MOTOR_NAMES)
        details = zip(DETAILS, (codec, motors, motors), cs7b.details(), strict=True)
        self._details = [
            (publish(node, JointState, f"~/{name}", STATE_QOS.profile), names.encoder(effort=values))
            for name, names, values in details
        ]
        self._detail_ns = cs7b.rates.period_ns * cs7b.rates.ratio * declare_decimation(node)
        self._accepted = node.create_publisher(JointTrajectory, f"~/{TRAJECTORY_ACCEPTED}", LATCHED_QOS.profile)
        self._report: GuardCondition | None = None
        self.publishers = (
            self._reference,
            self._error,
            self._accepted,
            *(publisher for publisher, _ in self._details),
            *([state.publisher] if state is not None else []),
            channel.publisher,
        )
        self._log = node.get_logger()

    def wait_for_subscribers(self) -> None:
        """Wait until subscribers, also those of the commands, are matched."""
        endpoints.wait_until_matched(self._node, self.publishers, _MATCH_ATTEMPTS)

    def publish(self, stamp_ns: int) -> None:
        """Publish what the position loop has left."""
        # What nobody listens to is not sent: a message costs the tick more than the law.
        if self._reference.get_subscription_count():
            self._cs7b.reference()
            self._reference.publish(self._encode_reference(stamp_ns))
        if self._error.get_subscription_count():
            self._cs7b.tracking_error()
            self._error.publish(self._encode_error(stamp_ns))
        if stamp_ns % self._detail_ns == 0:
            self._publish_details(stamp_ns)
        if self._state is not None and stamp_ns % self._state.period_ns == 0:
            self._state.publish(stamp_ns)

    def _publish_details(self, stamp_ns: int) -> None:
        self._cs7b.details()
        for publisher, encode in self._details:
            if publisher.get_subscription_count():
                publisher.publish(encode(stamp_ns))

    def report_with(self, report: Callable[[], None]) -> None:
        """Have `report` called by the node's executor after each `wake`."""
        self._report = self._node.create_guard_condition(report)

    def wake(self) -> None:
        """Wake the executor; callable from every thread."""
        if self._report is not None:
            self._report.trigger()

    def accepted(self, trajectory: JointTrajectory, start_ns: int, source: str = "") -> None:
        """Publish a trajectory as it came, stamped with its start; the frame says where from."""
        taken = JointTrajectory(joint_names=trajectory.joint_names, points=trajectory.points)
        taken.header.stamp, taken.header.frame_id = ros_time(start_ns), source
        self._accepted.publish(taken)

    # rclpy takes a line of code for one severity only: it must not see who else calls these.

    def info(self, text: str) -> None:
        """Print what happened."""
        self._log.info(one_line(text))

    def error(self, text: str) -> None:
        """Print what went wrong."""
        self._log.error(one_line(text))


class Control:
    """What a configured controller consists of, and its ticking thread's loop; the torque is off until `activate`.

    Args:
        node: owner of topics, services and parameters.
        files: the robot's.
        make_channel: makes the exchange with the simulation.
        local: whether a simulation in this process tells how time is kept, by `follow`; else the topic does.

    Raises:
        Rx90Error: for files and parameters that are refused, and a second controller.

    Attributes:
        publishers: of all that the ticking thread sends.
    """

    def __init__(self, node: ManagedNode, files: RobotFiles, make_channel: MakeChannel, *, local: bool) -> None:
        self.node = node
        self._log = self.node.get_logger()
        rates = declare_rates(self.node)
        robot, self._cs7b, self._law = self._build(files, rates)
        cs7b = self._cs7b
        channel = make_channel(self.node, MOTOR_COMMANDS, MOTOR_STATES, TICK_QOS.profile)
        goals = declare_goal_parameters(self.node, cs7b.joint_names, rates)
        if goals.without_use:
            self._log.warning(
                f"not used, parameters of joint_trajectory_controller: {', '.join(goals.without_use)}; the law is the "
                "CS7B's, set-points go on from set-points along splines, and whatever stops decelerates"
            )
        state = make_controller_state(self.node, cs7b, goals)
        outputs = ControllerOutputs(self.node, channel, cs7b, robot.model.name, state)
        self.publishers = outputs.publishers
        self._loop = ServoLoop(cs7b, outputs, declare_horizon(self.node), goals.monitor_ticks)
        self._loop.active = self._loop.enabled = False
        self._law.change_with(self._loop.law_changes.add)
        with self._loop.between_ticks() as requests:
            requests.options, requests.tolerances = goals.options, goals.tolerances
            requests.scale(goals.scaling)
        outputs.report_with(self._loop.report)
        messages = MotorMessages(channel.subscribe_topic, MOTOR_NAMES, rates, cs7b.command, outputs.error)
        pacer = Pacer(rates.period, 1.0)
        self._serving = Serving(channel, messages, self._loop, pacer, outputs.info, plain(robot.model.name))
        self._complaints = ThrottledLog(outputs.error)
        if not local:
            subscribe(self.node, String, TIME_MODE, self._on_mode, LATCHED_QOS.profile)
        qos = TRAJECTORY_QOS.profile
        subscribe(self.node, JointTrajectory, _TRAJECTORY, self._loop.offer, qos, check_trajectory_bytes)
        self.node.create_service(SetBool, "~/enable", self._on_enable, qos_profile=REQUEST_QOS.profile)
        self._action = make_action(self.node, self._loop, cs7b, channel)
        allow_goal_changes(node, cs7b, self._loop)
        self._diagnostics = Diagnostics(self.node, ControllerStatus(cs7b, self._loop, self._serving, pacer).collect)

    def _build(self, files: RobotFiles, rates: Rates) -> tuple[RobotModel, CS7B, LawParameters]:
        robot, drives = load_robot(files.urdf), load_drives(files.drives)
        law = LawParameters(
            self.node, files.controller, partial(CS7BParameters.record, robot=robot, drives=drives, rates=rates)
        )
        cs7b = CS7B(robot, drives, law.parameters, rates)
        cs7b.warm_up()
        return robot, cs7b, law

    # Transitions, on the executor's thread.

    def activate(self) -> None:
        """Give the motors torque: hold the arm, follow trajectories."""
        self._loop.activate(True)

    def deactivate(self) -> None:
        """End the motion; torque off, brakes closed. Ticks are answered all the same, and time goes on."""
        self._loop.activate(False)
        self._loop.report()
        self._log.info("inactive: torque off, brakes closed")

    def close(self) -> None:
        """End the action, once nothing ticks any more; what else it has made of the node is destroyed by others."""
        if self._action is not None:
            self._action.close()

    # The ticking thread.

    def tick_loop(self) -> None:
        """Answer the simulation until `stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        self._serving.run()
        endpoints.wait_until_received(self.publishers)

    def hand_over(self) -> Callable[[], None]:
        """Return what answers one tick in lock-step, to be called by the thread that ticks; `tick_loop` then rests."""
        return self._serving.hand_over()

    def follow(self, time_mode: TimeMode) -> None:
        """Keep time as a simulation in this process does.

        Raises:
            ExchangeError: if its rates or its robot are not this one's.
        """
        self._serving.follow(time_mode)

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self._serving.stop()

    def flush_before_shutdown(self) -> None:
        """Send what there is to say before the node ends; not from within a callback."""
        if self._action is not None:
            self._action.end()
        self._loop.report()

    # Topics, services and diagnostics, on the executor's thread.

    def _on_mode(self, message: String) -> None:
        try:
            self._serving.follow(TimeMode.parse(message.data))
        except MessageError as error:
            self._complaints.say("mode", f"{error}; ignored")
        except ExchangeError:
            pass  # ends `tick_loop`

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data and not self._loop.active:
            response.message = INACTIVE
            return response
        self._loop.enable(request.data)
        response.success = True
        response.message = "torque on" if request.data else "torque off, brakes closed"
        self._log.info(response.message)
        return response


def make_action(node: Node, loop: ServoLoop, cs7b: CS7B, channel: TickChannel) -> FollowJointTrajectoryAction | None:
    """Serve the action and what belongs to it; without control_msgs say once how to get it, and return None."""
    missing = missing_control_msgs()
    if missing is not None:
        node.get_logger().info(f"the action follow_joint_trajectory is off: {missing}")
        return None
    from rx90_controller.node.action_server import FollowJointTrajectoryAction
    from rx90_controller.node.client_topics import SpeedScaling, StateQuery

    SpeedScaling(node, loop)
    StateQuery(node, loop, cs7b)
    return FollowJointTrajectoryAction(
        node, loop, cs7b.joint_names, cs7b.rates, lambda: channel.matches().publishers > 0
    )


def make_controller_state(node: Node, cs7b: CS7B, parameters: GoalParameters) -> ControllerState | None:
    """Return what publishes the controller's state; None without control_msgs."""
    if missing_control_msgs() is not None:
        return None
    from rx90_controller.node.client_topics import ControllerState

    return ControllerState(node, cs7b, parameters.state_ticks)


class ControllerStatus:
    """How law, loops and ticks go; asked once a second by the executor's thread."""

    def __init__(self, cs7b: CS7B, loop: ServoLoop, serving: Serving, pacer: Pacer) -> None:
        self._cs7b, self._loop, self._serving, self._pacer = cs7b, loop, serving, pacer
        self._reported = (0, time.monotonic())  # tick and time of the last one

    def collect(self) -> tuple[bytes, str, dict[str, str]]:
        """Return the level, the message and the values, as `Diagnostics` asks for them."""
        cs7b, counts = self._cs7b, self._pacer.take()
        rates = cs7b.rates
        rejected, last_rejection = self._loop.rejections
        values = {
            "time mode": self._serving.mode or "unknown: no simulation yet",
            "controller time, s": f"{cs7b.tick * rates.period:.3f}",
            "rate, Hz": f"{self._rate():.1f}",
            "saturated ticks": " ".join(str(n) for n in cs7b.saturated),
            "rejected trajectories": str(rejected),
            "last rejection": last_rejection or "none",
            "enabled": "true" if self._loop.enabled else "false",
        }
        if self._serving.mode == FREE_RUNNING:
            values |= {
                "worst period, ms": f"{counts.worst * 1e3:.3f}",
                "late ticks": str(counts.late),
                "dropped ticks": str(counts.dropped),
            }
        fault = self._loop.fault
        if fault is not None:
            return DiagnosticStatus.ERROR, f"{fault}; torque off, brakes closed", values
        if not self._loop.running:
            return DiagnosticStatus.WARN, "waiting for the simulation", values
        if not self._loop.active:
            return DiagnosticStatus.OK, "inactive", values
        moving = cs7b.trajectory.moving(cs7b.position_tick)
        return DiagnosticStatus.OK, "following a trajectory" if moving else "holding", values

    def _rate(self) -> float:
        """Return the ticks per second since the last call; 0 over a reset."""
        (tick, at), self._reported = self._reported, (self._cs7b.tick, time.monotonic())
        now_tick, now = self._reported
        return max(0.0, (now_tick - tick) / (now - at))
