"""What a configured simulation consists of: the plant, its ticks, the topics and services around them."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.node_tools import Diagnostics
from rx90_common.exchange.pacing import check_factor
from rx90_common.exchange.qos import LATCHED_QOS, REQUEST_QOS
from rx90_common.exchange.tick_channel import MakeChannel
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import LOCK_STEP, MOTOR_STATES, TIME_MODE
from rx90_sim.node.parameters import SimulationParameters, build_plant
from rx90_sim.node.ticks import Ticks
from rx90_sim.node.transforms import Transforms
from rx90_sim.winding import warm_motors

_REQUEST_TIMEOUT = 5.0  # s


class SimulatedArm:
    """An arm at rest, at time 0, which stands still until it is activated; services and diagnostics.

    Args:
        node: owner of topics and services.
        files: the robot's.
        parameters: of the node.
        make_channel: makes the exchange with the controller.
        step_ticks: returns how many ticks a call of ~/step runs.

    Attributes:
        ticks: for the ticking thread.
        time_mode: how time is kept.

    Raises:
        Rx90Error: for files and parameters that are refused, and a second simulation.
    """

    def __init__(
        self,
        node: Node,
        files: RobotFiles,
        parameters: SimulationParameters,
        make_channel: MakeChannel,
        step_ticks: Callable[[], int],
    ) -> None:
        self._node, self._parameters, self._step_ticks = node, parameters, step_ticks
        robot, self._plant = build_plant(node, files, parameters)
        self._warm = False
        self._robot_name = plain(robot.model.name)
        transforms = Transforms.of_parameters(node, robot, self._plant, parameters)
        self.ticks = Ticks(node, self._plant, parameters, make_channel, transforms)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS.profile)
        self._description.publish(String(data=robot.urdf))
        self._mode = node.create_publisher(String, TIME_MODE, LATCHED_QOS.profile)
        self.time_mode = TimeMode(parameters.time_mode, parameters.rates, self._robot_name)
        self._mode.publish(String(data=self.time_mode.text))
        node.create_service(SetBool, "~/pause", self._on_pause, qos_profile=REQUEST_QOS.profile)
        node.create_service(Trigger, "~/step", self._on_step, qos_profile=REQUEST_QOS.profile)
        node.create_service(Trigger, "~/reset", self._on_reset, qos_profile=REQUEST_QOS.profile)
        self._diagnostics = Diagnostics(node, self._status)

    def activate(self) -> None:
        """Let time run."""
        self._node.get_logger().info(self._ready_text())
        self.ticks.control.release()

    def deactivate(self) -> None:
        """Let time stand still: a pause that no service but the lifecycle's ends."""
        self.ticks.control.hold()
        self._node.get_logger().info(f"inactive: time stands still at {self.ticks.time:.6g} s")

    def check_pace(self, factor: float) -> float:
        """Return a real-time factor that time can be paced to.

        Raises:
            ConfigError: if it cannot, or time is the wall clock's.
        """
        if self._parameters.time_mode != LOCK_STEP:
            raise ConfigError(f"real_time_factor: time_mode is {self._parameters.time_mode}; accepted: in {LOCK_STEP}")
        check_factor(factor)
        return factor

    def _ready_text(self) -> str:
        node, parameters = self._node, self._parameters
        text = f"ready: {self._robot_name}, {parameters.time_mode} at {parameters.rates.base_hz} Hz"
        if parameters.time_mode == LOCK_STEP:
            text += f", real_time_factor {node.get_parameter('real_time_factor').value:g}"
        if self._plant.substeps > 1:
            text += f", {self._plant.substeps} plant steps in a tick"
        text += f", states on {node.resolve_topic_name(MOTOR_STATES)}"
        if self.ticks.control.paused:
            text += f"; paused until {node.resolve_service_name('~/pause')} is called with false"
        return text

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
        ticks = self._step_ticks()
        return self._answer(response, self.ticks.control.step(ticks, _REQUEST_TIMEOUT), f"{ticks} ticks")

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self.ticks.control.reset(_REQUEST_TIMEOUT), "reset")

    def _answer(self, response: Trigger.Response, done: bool, what: str) -> Trigger.Response:
        response.success = done
        at = f"at {self.ticks.time:.6g} s"
        response.message = f"{what} done, {at}" if done else f"{what} not done within {_REQUEST_TIMEOUT:g} s, {at}"
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        ticks, plant = self.ticks, self._plant
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
        texts = warm_motors(plant.constants, plant.winding_temperatures()), plant.temperatures.beyond_law()
        warm = "; ".join(text for text in texts if text)
        if plant.temperatures.elements:
            values["joints, °C"] = " ".join(f"{plant.temperatures.now[i]:.1f}" for i in plant.temperatures.elements)
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
