"""The simulation node: parameters, lifecycle, services and diagnostics around the ticks of one plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import counted, one_line, plain
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.channel import Channel, MakeChannel
from rx90_common.exchange.endpoints import LATCHED_QOS, REQUEST_QOS
from rx90_common.exchange.lifecycle import ManagedNode, publish_diagnostics, started
from rx90_common.exchange.lifecycle import spin as spin_nodes
from rx90_common.exchange.pacing import check_factor
from rx90_common.exchange.parameters import Effective
from rx90_common.exchange.topics import (
    COMMAND_INTERFACES,
    JOINT_INTERFACE,
    LOCK_STEP,
    SEED,
    TIME_MODE,
    TimeMode,
)
from rx90_common.friction import load_friction
from rx90_sim.drives import warm_motors
from rx90_sim.node.parameters import SimulationParameters
from rx90_sim.node.ticks import Ticks
from rx90_sim.plant import Plant, beyond_law

_REQUEST_TIMEOUT = 5.0  # s


class Simulation:
    """The node; between configure and clean-up it has a `SimulatedArm`.

    Args:
        make_channel: makes the exchange with the controller.
        own_args: arguments for ROS that concern this node of its process alone.

    Attributes:
        node: for the executor.
    """

    def __init__(self, make_channel: MakeChannel = Channel, own_args: Sequence[str] = ()) -> None:
        self.node = ManagedNode("rx90_sim", own_args, self, make_channel)
        self._arm: SimulatedArm | None = None
        self._follow: Callable[[TimeMode | None], None] = lambda _: None
        self._also_listening: Callable[[], Sequence[Publisher]] = tuple
        self.node.parameters.declare(SimulationParameters.of(self.node.parameters.values))

    def lead(
        self,
        follow: Callable[[TimeMode | None], None],
        publishers: Callable[[], Sequence[Publisher]],
    ) -> None:
        """Let a controller in this process follow the time mode.

        Args:
            follow: called with the time mode, or with None when it ends; raises ExchangeError for rates or a robot that
                differ from the controller's own.
            publishers: returns the publishers whose messages must arrive as well before a run that is not paced goes
                on.
        """
        self._follow = follow
        self._also_listening = publishers

    def configure(self) -> None:
        """Load the robot; time stands still."""
        parameters = SimulationParameters.of(self.node.parameters.values)
        files = parameters.files()
        self._arm = arm = SimulatedArm(self.node, files, parameters)
        arm.ticks.listeners.others = self._also_listening
        self._allow("real_time_factor", arm.check_pace, arm.ticks.pacer.change)
        self._allow("step_ticks", int, lambda _: None)  # looked at by each call
        self.node.changes.publish_constants(SEED)
        self._follow(arm.time_mode)
        self.node.ticking.begin(arm.ticks.run, arm.ticks.control.stop)

    def _allow(self, name: str, check: Callable[[Any], Any], change: Callable[[Any], None]) -> None:
        def apply(value: Any, effective: Effective) -> None:
            change(value)
            if self._arm is not None:
                effective(self._arm.ticks.next_stamp_ns)

        self.node.changes.allow((name,), lambda values: check(values[name]), apply)

    def activate(self) -> None:
        """Let time run."""
        if self._arm is not None:
            self._arm.activate()

    def deactivate(self) -> None:
        """Stop time."""
        if self._arm is not None:
            self._arm.deactivate()

    def cleanup(self) -> None:
        """Let go of the robot."""
        self.node.ticking.finish()
        self._follow(None)
        self._arm = None

    def tick_loop(self) -> None:
        """Run ticks until the end of the run or `stop`.

        Raises:
            DivergenceError: naming joint and tick.
        """
        self.node.ticking.loop()

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self.node.ticking.stop()


class SimulatedArm:
    """An arm at rest, at time 0, which stands still until it is activated; its topics, services and diagnostics.

    Args:
        node: owner of topics and services.
        files: the robot's.
        parameters: of the node.

    Attributes:
        ticks: for the ticking thread.
        time_mode: the time mode.
    """

    def __init__(
        self, node: ManagedNode, files: RobotFiles, parameters: SimulationParameters
    ) -> None:
        self._node = node
        self._parameters = parameters
        robot, self._plant = _build_plant(node, files, parameters)
        self._warm = False
        self._robot_name = plain(robot.model.name)
        self.ticks = Ticks(node, robot, self._plant, parameters)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=robot.urdf))
        self._mode = node.create_publisher(String, TIME_MODE, LATCHED_QOS)
        self.time_mode = TimeMode(parameters.time_mode, parameters.rates, self._robot_name)
        self._mode.publish(String(data=self.time_mode.text))
        node.create_service(SetBool, "~/pause", self._on_pause, qos_profile=REQUEST_QOS)
        node.create_service(Trigger, "~/step", self._on_step, qos_profile=REQUEST_QOS)
        node.create_service(Trigger, "~/reset", self._on_reset, qos_profile=REQUEST_QOS)
        publish_diagnostics(node, self._status)

    def activate(self) -> None:
        """Let time run."""
        node = self._node
        parameters = self._parameters
        text = f"ready: {self._robot_name}, {parameters.time_mode} at {parameters.rates.base_hz} Hz"
        if parameters.time_mode == LOCK_STEP:
            text += f", real_time_factor {node.get_parameter('real_time_factor').value:g}"
        if self._plant.substeps > 1:
            text += f", {self._plant.substeps} plant steps in a tick"
        states, commands = COMMAND_INTERFACES[parameters.command_interface]
        text += f", states on {node.resolve_topic_name(states)}"
        if parameters.command_interface == JOINT_INTERFACE:
            text += (
                f", efforts on {node.resolve_topic_name(commands)} at {parameters.command_hz} Hz"
            )
        if self.ticks.control.paused:
            text += f"; paused until {node.resolve_service_name('~/pause')} is called with false"
        node.get_logger().info(text)
        self.ticks.control.release()

    def deactivate(self) -> None:
        """Stop time: a pause that only the lifecycle ends, no service."""
        self.ticks.control.hold()
        self._node.get_logger().info(f"inactive: time stands still at {self.ticks.time:.6g} s")

    def check_pace(self, factor: float) -> float:
        """Return a real-time factor that time can be paced to."""
        if self._parameters.time_mode != LOCK_STEP:
            raise ConfigError(
                f"real_time_factor: time_mode is {self._parameters.time_mode}; accepted: in {LOCK_STEP}"
            )
        return check_factor(factor)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self.ticks.control.pause()
        else:
            self.ticks.control.resume()
        response.success = True
        response.message = "time stands still" if request.data else "time runs"
        if self.ticks.control.held:
            response.message += ", once the node is active"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.ticks.control.held:
            response.message = "the node is inactive; accepted: in state active"
            return response
        ticks: int = self._node.get_parameter("step_ticks").value
        return self._answer(
            response, self.ticks.control.step(ticks, _REQUEST_TIMEOUT), counted(ticks, "tick")
        )

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self.ticks.control.reset(_REQUEST_TIMEOUT), "reset")

    def _answer(self, response: Trigger.Response, done: bool, what: str) -> Trigger.Response:
        response.success = done
        at = f"at {self.ticks.time:.6g} s"
        response.message = (
            f"{what} done, {at}" if done else f"{what} not done within {_REQUEST_TIMEOUT:g} s, {at}"
        )
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        ticks = self.ticks
        plant = self._plant
        counts = ticks.pacer.take()
        rate = counts.ticks / counts.seconds if counts.seconds > 0 else 0.0
        values = {
            "time mode": self._parameters.time_mode,
            "simulated time, s": f"{ticks.time:.3f}",
            "rate, Hz": f"{rate:.1f}",
            "real-time factor": f"{rate * self._parameters.rates.period:.3f}",
            "worst period, ms": f"{counts.worst * 1e3:.3f}",
            "late ticks": str(counts.late),
            "dropped ticks": str(counts.dropped),
            "ticks without a fresh command": str(ticks.held.missed),
            "ticks that waited for a command": str(ticks.held.waited),
            "commands out of turn": str(ticks.lockstep.ignored),
            "brakes": "closed" if plant.brakes_closed else "open",
            "plant steps in a tick": str(plant.substeps),
            "saturated ticks": " ".join(str(n) for n in plant.saturated),
        }
        texts = (
            warm_motors(plant.constants, plant.winding_temperatures()),
            beyond_law(plant.friction, plant.temperatures),
        )
        warm = "; ".join(filter(None, texts))
        joints = zip(plant.friction.elements, plant.temperatures, strict=True)
        if of_joints := [
            f"{now:.1f}" for element, now in joints if element.temperature is not None
        ]:
            values["joints, °C"] = " ".join(of_joints)
        if plant.constants["winding"]["used"][0]:
            values["windings, °C"] = " ".join(f"{one:.1f}" for one in plant.winding_temperatures())
        if warm and not self._warm:
            self._node.get_logger().warning(warm)
        self._warm = bool(warm)
        if ticks.control.held:
            return DiagnosticStatus.OK, "inactive", values
        if ticks.control.paused:
            return DiagnosticStatus.OK, "paused", values
        if ticks.held.two_controllers:
            return DiagnosticStatus.ERROR, "two controllers send commands", values
        if counts.ticks == 0:
            return DiagnosticStatus.WARN, "waiting for the controller", values
        if warm:
            return DiagnosticStatus.WARN, warm, values
        behind = counts.dropped > 0 and self._parameters.time_mode != LOCK_STEP
        return DiagnosticStatus.WARN if behind else DiagnosticStatus.OK, "running", values


def spin(args: Sequence[str]) -> None:
    """Run the node until it ends or is interrupted."""
    spin_nodes(lambda: started([Simulation()]), args)


def _build_plant(
    node: Node, files: RobotFiles, parameters: SimulationParameters
) -> tuple[RobotModel, Plant]:
    """Read the robot's files and put the arm at its initial position."""
    robot = load_robot(files.urdf, files.tool)
    drives = load_drives(files.drives)
    substeps = parameters.substeps or None
    robot.check_count(files.drives, "gear", drives.gear)
    friction = load_friction(files.friction, drives.turning.element_names(robot.joint_names))
    for line in friction.passivity_warnings(drives.turning.reach(robot.max_velocity)):
        node.get_logger().warning(one_line(line))
    plant = Plant(robot, drives, friction, parameters.rates, substeps, parameters.seed)
    plant.reset(parameters.start(robot))
    plant.warm_up()
    return robot, plant
