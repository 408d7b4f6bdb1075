"""The controller node: parameters, topics and services around one control law, and its lifecycle."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.errors import ExchangeError
from rx90_common.base.models import refusals
from rx90_common.base.quoting import one_line, plain
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import load_robot
from rx90_common.exchange import lifecycle
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Channel, MakeChannel
from rx90_common.exchange.endpoints import (
    LATCHED_QOS,
    REQUEST_QOS,
    STATE_QOS,
    TRAJECTORY_QOS,
    ros_time,
    subscribe,
    wait_until_matched,
    wait_until_received,
)
from rx90_common.exchange.lifecycle import ManagedNode, publish_diagnostics, started
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.parameters import nested
from rx90_common.exchange.ros_start import missing_messages
from rx90_common.exchange.topics import (
    COMMANDED_CORRECTION,
    CORRECTION,
    DETAILS,
    FREE_RUNNING,
    MOTOR_COMMANDS,
    MOTOR_STATES,
    REFERENCE,
    TRAJECTORY_ACCEPTED,
    TimeMode,
    motor_names,
)
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.parameters import load_controller
from rx90_controller.node.parameters import (
    LAW_BLOCKS,
    OF_ROBOT,
    ControllerFiles,
    ControllerParameters,
    law_of,
    unused_parameters,
)
from rx90_controller.node.serving import Serving
from rx90_controller.node.servo_loop import ServoLoop
from rx90_controller.node.simulation_mode import SimulationMode
from rx90_controller.servo.events import TorqueSwitch
from rx90_controller.trajectory.request import Constraints, GoalOptions, GoalTolerances
from rx90_controller.trajectory.stream import from_message

if TYPE_CHECKING:
    from rx90_controller.node.client_interfaces import ClientInterfaces

_TRAJECTORY = "~/joint_trajectory"
_SET_POINTS = "~/joint_setpoints"
_COMMANDS = "~/commands"
_MATCH_ATTEMPTS = 100  # of 50 ms


class Control:
    """The parts of a configured controller, and the `Outputs` of its loop; the torque is off until that is active.

    Args:
        node: owner of topics, services and parameters.
        local: whether a simulation in this process announces the time mode, by `serving.follow`, and calls
            `serving.answer`; else the topic announces it.

    Attributes:
        loop: follows trajectories.
        serving: runs it tick by tick.
        publishers: of all that the ticking thread sends.
        clients: None without control_msgs.
        ready: the line for the log once the first states have arrived.
    """

    _torque_told = False

    def __init__(self, node: ManagedNode, *, local: bool) -> None:
        self._node = node
        self._log = node.get_logger()
        given = node.parameters.values
        unused = unused_parameters(given)
        node.parameters.ignore(unused)
        parameters = ControllerParameters.of(given)
        node.parameters.declare(parameters)
        files = parameters.files()
        rates = parameters.rates
        robot = load_robot(files.urdf)
        drives = load_drives(files.drives)
        of_file = load_controller(files.controller)
        law = parameters.law(of_file)
        robot.check_count(files.drives, "gear", drives.gear)
        robot.check_count(files.controller, "inertia", law.inertia)
        motor = motor_names(len(robot.joint_names))
        self._cs7b = cs7b = CS7B(robot, drives, law, rates)
        cs7b.warm_up()
        name = plain(robot.model.name)
        tick_ns = rates.period_ns * rates.ratio
        channel = node.make_channel(MOTOR_COMMANDS, MOTOR_STATES)
        monitor_ticks = max(1, round(rates.position_hz / parameters.action_monitor_rate))
        state_ticks = max(1, round(rates.position_hz / parameters.state_publish_rate))
        if unused:
            self._log.warning(
                f"not used, parameters of joint_trajectory_controller: {', '.join(unused)}; the law is the "
                "CS7B's, set-points go on from set-points along splines, and whatever stops decelerates"
            )
        self.ready = (
            f"ready: {name}, velocity loops at {rates.base_hz} Hz, position loops at {rates.position_hz} Hz, states on "
            f"{channel.subscribe_topic}, trajectories on {node.resolve_topic_name(_TRAJECTORY)}"
        )

        def topic(name: str) -> Publisher:
            return node.create_publisher(JointState, f"~/{name}", STATE_QOS)

        # The arrays are always the same, brought up to date by a call of the same method.
        codec = JointStateCodec(cs7b.joint_names)
        motors = JointStateCodec(motor)
        details = zip(DETAILS, (codec, motors, motors), cs7b.details(), strict=True)
        reference = topic(REFERENCE), codec.encoder(*cs7b.reference())
        error = topic("tracking_error"), codec.encoder(*cs7b.tracking_error())
        self._offset = np.zeros(len(cs7b.joint_names))
        self._correction = topic(CORRECTION), codec.encoder(position=self._offset)
        slow = [(topic(detail), names.encoder(effort=values)) for detail, names, values in details]
        self._topics = [
            (1, cs7b.reference, [reference]),
            (1, cs7b.tracking_error, [error]),
            (tick_ns * parameters.slow_topics_every_n_ticks, cs7b.details, slow),
        ]
        self._accepted = node.create_publisher(
            JointTrajectory, f"~/{TRAJECTORY_ACCEPTED}", LATCHED_QOS
        )
        self.loop = loop = ServoLoop(cs7b, self, parameters.max_seconds_ahead, monitor_ticks)
        loop.post(TorqueSwitch(on=False, by_node=True))
        node.changes.allow(
            _declared(node, LAW_BLOCKS),
            lambda values: law_of(of_file, values).record(robot, drives, rates),
            loop.change_law,
        )
        loop.options = parameters
        loop.tolerances = parameters.tolerances
        loop.servo.streaming = parameters.stream
        loop.scale_speed(parameters.speed_scaling.initial_scaling_factor)
        self._report = node.create_guard_condition(self.report)
        self._pacer = pacer = Pacer(rates.period, 1.0)
        self.serving = Serving(
            channel, motor, rates, loop, pacer, name, self.info, self.error, local=local
        )
        self._subscribe(loop, local=local)
        node.create_service(SetBool, "~/enable", self._on_enable, qos_profile=REQUEST_QOS)
        interfaces = import_optional(
            node,
            "client_interfaces",
            "the action follow_joint_trajectory is",
            missing_messages("control_msgs"),
        )
        self.clients: ClientInterfaces | None = None
        if interfaces is not None:
            self.clients = interfaces.ClientInterfaces(node, loop, cs7b, state_ticks, channel)
        manager = parameters.controller_manager
        if manager and (services := import_optional(
            node,
            "manager_services",
            "the services of a controller_manager are",
            missing_messages("controller_manager_msgs"),
        )):  # fmt: skip
            services.ManagerServices(
                node, manager, loop, cs7b.joint_names, name, (rates.position_hz, rates.base_hz)
            )
        self.publishers: tuple[Publisher, ...] = (
            *(publisher for _, _, messages in self._topics for publisher, _ in messages),
            self._correction[0],
            self._accepted,
            *([] if self.clients is None else [self.clients.publisher]),
            channel.publisher,
        )
        _allow_goal_changes(node, cs7b.joint_names, loop)
        self._reported = (0, time.monotonic())  # tick and time of the last status
        self._publish_status = publish_diagnostics(node, self._status)

    def _subscribe(self, loop: ServoLoop, *, local: bool) -> None:
        node = self._node
        if not local:
            SimulationMode(node, self._on_mode)
        # Before that of the trajectories: of two that wait the executor takes the first one first.
        correction = f"~/{COMMANDED_CORRECTION}"
        subscribe(node, JointTrajectory, correction, loop.receive_correction, TRAJECTORY_QOS)
        subscribe(node, JointTrajectory, _TRAJECTORY, loop.receive, TRAJECTORY_QOS)
        for kind, source in ((JointState, _SET_POINTS), (Float64MultiArray, _COMMANDS)):
            subscribe(node, kind, source, partial(self._on_set_point, source), TRAJECTORY_QOS)

    # The ticking thread.

    def tick_loop(self) -> None:
        """Answer the simulation until `serving.stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        self.serving.run()
        wait_until_received(self.publishers)

    def wait_for_subscribers(self) -> None:
        """Wait until subscribers, also those of the commands, are matched."""
        wait_until_matched(self._node, self.publishers, _MATCH_ATTEMPTS, self.serving.is_stopped)

    def publish(self, stamp_ns: int) -> None:
        """Publish the results of the position loop."""
        # What nobody listens to is not sent: a message costs the tick more than the law.
        for every_ns, update, messages in self._topics:
            if stamp_ns % every_ns:
                continue
            heard = [row for row in messages if row[0].get_subscription_count()]
            if heard:
                update()
            for publisher, encode in heard:
                publisher.publish(encode(stamp_ns))
        offset = self._cs7b.offset
        (publisher, encode) = self._correction
        if offset is not None and offset.any() and publisher.get_subscription_count():
            self._offset[:] = offset
            publisher.publish(encode(stamp_ns))
        if self.clients is not None:
            self.clients.publish_state(stamp_ns)

    # Any thread.

    def wake(self) -> None:
        """Have the node's executor report."""
        self._report.trigger()

    def accepted(self, trajectory: JointTrajectory, start_ns: int, source: str) -> None:
        """Publish a trajectory as received, stamped with its start; the frame names its source."""
        followed = JointTrajectory(joint_names=trajectory.joint_names, points=trajectory.points)
        followed.header.stamp = ros_time(start_ns)
        followed.header.frame_id = source
        self._accepted.publish(followed)

    # rclpy accepts one severity for a line of code: the callers of these must remain hidden from it.

    def info(self, text: str) -> None:
        """Print an event."""
        self._log.info(one_line(text))

    def error(self, text: str) -> None:
        """Print a problem."""
        self._log.error(one_line(text))

    # Topics, services and diagnostics, on the executor's thread.

    def _on_mode(self, mode: TimeMode) -> None:
        with suppress(ExchangeError):  # ends `tick_loop`
            self.serving.follow(mode)

    def _on_set_point(self, source: str, message: JointState | Float64MultiArray) -> None:
        """Follow a streamed set-point: positions, with velocities or without, or velocities.

        Those without names are as those of ros2_controllers' forward_command_controller.
        """
        loop = self.loop
        names = self._cs7b.joint_names
        some = loop.options.allow_partial_joints_goal
        loop.receive_stream(
            lambda: from_message(names, message, loop.servo.streaming, partial=some), source
        )

    def report(self) -> None:
        """Print, publish and send what has come up; tell at once that the torque has gone on or off."""
        self.loop.report()
        torque = self.loop.state.switch.on
        if torque != self._torque_told:
            self._torque_told = torque
            self._publish_status()

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        refusal = self.loop.enable(request.data)
        response.success = not refusal
        response.message = refusal or ("torque on" if request.data else "torque off, brakes closed")
        if response.success:
            self._log.info(response.message)
        self.report()
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        """Return level, message and values of how law, loops and ticks go, for diagnostics."""
        cs7b = self._cs7b
        state = self.loop.state
        switch = state.switch
        servo = self.loop.servo
        counts = self._pacer.take()
        (tick, at) = self._reported
        self._reported = (cs7b.tick, time.monotonic())
        now_tick, now = self._reported
        values = {
            "time mode": self.serving.mode or "unknown: no simulation yet",
            "controller time, s": f"{cs7b.tick * cs7b.rates.period:.3f}",
            "rate, Hz": f"{max(0.0, (now_tick - tick) / (now - at)):.1f}",  # 0 over a reset
            "saturated ticks": " ".join(str(n) for n in cs7b.saturated),
            "rejected trajectories": str(servo.rejected),
            "last rejection": servo.last_rejection or "none",
            "stream": "none" if state.stream is None else state.stream.summary,
            "enabled": "true" if switch.on else "false",
        }
        if self.serving.mode == FREE_RUNNING:
            values |= {
                "worst period, ms": f"{counts.worst * 1e3:.3f}",
                "late ticks": str(counts.late),
                "dropped ticks": str(counts.dropped),
            }
        if switch.fault is not None:
            return DiagnosticStatus.ERROR, f"{switch.fault}; torque off, brakes closed", values
        if not state.started:
            return DiagnosticStatus.WARN, "waiting for the simulation", values
        if not switch.active:
            return DiagnosticStatus.OK, "inactive", values
        if not switch.on:
            return DiagnosticStatus.OK, "torque off, brakes closed", values
        if state.stream is not None:
            return DiagnosticStatus.OK, "following a stream", values
        doing = "following a trajectory" if servo.moving else "holding"
        return DiagnosticStatus.OK, doing, values


def import_optional(
    node: ManagedNode, name: str, what: str, missing: str | None
) -> ModuleType | None:
    """Return a module of this folder; if its requirements are missing, say once how to get them, and return None."""
    if missing is None:
        return import_module(f"rx90_controller.node.{name}")
    node.get_logger().info(f"{what} off: {missing}")
    return None


class ControllerNode:
    """The node; while configured, it has a `Control`.

    Args:
        make_channel: makes the exchange with the simulation.
        own_args: arguments for ROS that concern this node of its process alone.
        local: whether the simulation is in this process, and calls `follow`, and `answer` in each tick in lock-step.

    Attributes:
        node: for the executor.
    """

    def __init__(
        self,
        make_channel: MakeChannel = Channel,
        own_args: Sequence[str] = (),
        *,
        local: bool = False,
    ) -> None:
        self.node = ManagedNode("rx90_controller", own_args, self, make_channel)
        self._local = local
        self._control: Control | None = None
        self._time_mode: TimeMode | None = None
        self._answering = threading.Lock()
        self.node.parameters.declare(ControllerFiles.of(self.node.parameters.values))

    # Transitions, on the executor's thread.

    def configure(self) -> None:
        """Load the robot; the torque stays off."""
        self._control = control = Control(self.node, local=self._local)
        if self._time_mode is not None:
            control.serving.follow(self._time_mode)
        self.node.ticking.begin(control.tick_loop, control.serving.stop)

    def activate(self) -> None:
        """Give the motors torque: hold the arm, follow trajectories."""
        if self._control is not None:
            self._control.loop.post(TorqueSwitch(on=True, by_node=True))
            self._control.report()

    def deactivate(self) -> None:
        """End the motion; torque off, brakes closed. Ticks are still answered, and time goes on."""
        if self._control is not None:
            self._control.loop.post(TorqueSwitch(on=False, by_node=True))
            self._control.report()
            self.node.get_logger().info("inactive: torque off, brakes closed")

    def cleanup(self) -> None:
        """Let go of the robot."""
        self.node.ticking.finish()
        with self._answering:
            control = self._control
            self._control = None
        if control is not None and control.clients is not None:
            control.clients.close()
        self.node.parameters.forget(*OF_ROBOT)

    # A simulation in this process.

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Return the publishers of all that ticks send."""
        return () if self._control is None else self._control.publishers

    def follow(self, time_mode: TimeMode | None) -> None:
        """Use the simulation's time mode; None: there is no simulation.

        Raises:
            ExchangeError: if its rates or its robot differ from the controller's.
        """
        self._time_mode = time_mode
        if self._control is not None and time_mode is not None:
            self._control.serving.follow(time_mode)

    def answer(self) -> None:
        """Answer one tick in lock-step, on the thread that ticks; nothing while there is nothing to answer with."""
        with self._answering:
            if self._control is not None:
                self._control.serving.answer()

    # Its ticking thread, and the end.

    def tick_loop(self) -> None:
        """Answer the simulation until `stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        self.node.ticking.loop()

    def stop(self) -> None:
        """End `tick_loop` soon, and send the last messages."""
        self.node.ticking.stop()
        if self._control is not None:
            if self._control.clients is not None:
                self._control.clients.end()
            self._control.loop.report()


def spin(args: Sequence[str]) -> None:
    """Run the node until it is interrupted."""
    lifecycle.spin(lambda: started([ControllerNode()]), args)


def _allow_goal_changes(node: ManagedNode, names: Sequence[str], loop: ServoLoop) -> None:
    """Let options and tolerances be changed for the next goals and trajectories of an arm with these joints."""

    def read_tolerances(values: Mapping[str, Any]) -> GoalTolerances:
        with refusals(Constraints):
            constraints = Constraints.model_validate(nested(values)["constraints"])
        return GoalTolerances.of_parameters(names, constraints)

    node.changes.allow(
        tuple(GoalOptions.model_fields),
        lambda values: GoalOptions(**values),
        lambda options, effective: effective(loop.change(options=options)),
    )
    node.changes.allow(
        _declared(node, ("constraints",)),
        read_tolerances,
        lambda tolerances, effective: effective(loop.change(tolerances=tolerances)),
    )


def _declared(node: ManagedNode, blocks: Sequence[str]) -> list[str]:
    """Return the names of the declared parameters of some blocks."""
    return [name for name in node.get_parameters_by_prefix("") if name.partition(".")[0] in blocks]
