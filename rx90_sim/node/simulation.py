"""The simulation node: parameters, services and diagnostics around the ticks of one plant."""

from __future__ import annotations

from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.quoting import plain
from rx90_common.exchange import node_tools
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.node_tools import Diagnostics, declare
from rx90_common.exchange.qos import LATCHED_QOS
from rx90_common.exchange.tick_channel import MakeChannel
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import LOCK_STEP, MOTOR_STATES, TIME_MODE
from rx90_sim.node.parameters import build_plant, read_parameters
from rx90_sim.node.ticks import Ticks
from rx90_sim.node.transforms import Transforms

_REQUEST_TIMEOUT = 5.0  # s


class Simulation:
    """The node; its services and diagnostics are on the executor's thread.

    Args:
        make_channel: makes the exchange with the controller.
        own_args: arguments for ROS that concern this node of its process alone.

    Attributes:
        node: for the executor.
        time_mode: how time is kept.
    """

    def __init__(self, make_channel: MakeChannel = Channel, own_args: Sequence[str] = ()) -> None:
        self.node = node = Node("rx90_sim", cli_args=list(own_args))
        self._parameters = read_parameters(node)
        robot, self._plant = build_plant(node, self._parameters)
        self._robot_name = plain(robot.model.name)
        transforms = Transforms.of_parameters(node, robot, self._plant, self._parameters)
        self._ticks = Ticks(node, self._plant, self._parameters, make_channel, transforms)
        self._description = node.create_publisher(String, "robot_description", LATCHED_QOS.profile)
        self._description.publish(String(data=robot.urdf))
        self._mode = node.create_publisher(String, TIME_MODE, LATCHED_QOS.profile)
        self.time_mode = TimeMode(self._parameters.time_mode, self._parameters.rates, self._robot_name)
        self._mode.publish(String(data=self.time_mode.text))
        declare(node, "step_ticks", 1, "ticks of one call of ~/step", low=1, high=100_000_000, read_only=False)
        node.create_service(SetBool, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/step", self._on_step)
        node.create_service(Trigger, "~/reset", self._on_reset)
        self._diagnostics = Diagnostics(node, self._status)

    def tick_loop(self) -> None:
        """Run ticks until the end of the run or `stop`.

        Raises:
            DivergenceError: naming joint and tick.
        """
        self.node.get_logger().info(self._ready_text())
        self._ticks.run()

    def wait_also_for(self, publishers: Sequence[Publisher]) -> None:
        """Let what these have sent arrive, too, before a run that is not paced goes on."""
        self._ticks.listeners.add(publishers)

    def _ready_text(self) -> str:
        node, parameters = self.node, self._parameters
        text = f"ready: {self._robot_name}, {parameters.time_mode} at {parameters.rates.base_hz} Hz"
        if parameters.time_mode == LOCK_STEP:
            text += f", real_time_factor {parameters.real_time_factor:g}"
        text += f", states on {node.resolve_topic_name(MOTOR_STATES)}"
        if parameters.paused:
            text += f"; paused until {node.resolve_service_name('~/pause')} is called with false"
        return text

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self._ticks.control.stop()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._ticks.control.pause()
        else:
            self._ticks.control.resume()
        response.success = True
        response.message = "time stands still" if request.data else "time runs"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        ticks = self.node.get_parameter("step_ticks").value
        return self._answer(response, self._ticks.control.step(ticks, _REQUEST_TIMEOUT), f"{ticks} ticks")

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._ticks.control.reset(_REQUEST_TIMEOUT), "reset")

    def _answer(self, response: Trigger.Response, done: bool, what: str) -> Trigger.Response:
        response.success = done
        at = f"at {self._ticks.time:.6g} s"
        response.message = f"{what} done, {at}" if done else f"{what} not done within {_REQUEST_TIMEOUT:g} s, {at}"
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        ticks, plant = self._ticks, self._plant
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
            "saturated ticks": " ".join(str(n) for n in plant.saturated),
        }
        if ticks.control.paused:
            return DiagnosticStatus.OK, "paused", values
        if ticks.held.two_controllers:
            return DiagnosticStatus.ERROR, "two controllers send commands", values
        if counts.ticks == 0:
            return DiagnosticStatus.WARN, "waiting for the controller", values
        behind = counts.dropped > 0 and self._parameters.time_mode != LOCK_STEP
        return DiagnosticStatus.WARN if behind else DiagnosticStatus.OK, "running", values


def spin(args: Sequence[str]) -> None:
    """Run the node until it ends or is interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or a state that diverged.
    """
    node_tools.spin(lambda: [Simulation()], args)
