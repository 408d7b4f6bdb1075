"""The friction_bench node: a rig on ROS topics and services."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

from diagnostic_msgs.msg import DiagnosticStatus
from pydantic import Field
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.emulated import EmulatedRig, PtyRig
from friction_bench.rig.link import RigLink
from friction_bench.rig.messages import Fault, RigInputError, RigLostError, fault_text
from friction_bench.rig.rig_file import load_rig
from friction_bench.rig.serial_port import SerialPort
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import one_line, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.base.share import SHIPPED_RIG, resolve_config
from rx90_common.exchange.endpoints import REQUEST_QOS, ros_time
from rx90_common.exchange.lifecycle import publish_diagnostics
from rx90_common.exchange.lifecycle import spin as spin_node
from rx90_common.exchange.parameters import (
    NodeModel,
    NodeParameters,
    named_parameters,
    parameter_values,
)

JOINT = "rig_motor"
EMULATED = "emulated"
_ALIVE_PERIOD = 0.02
_SERVICE_TIMEOUT = 3.0
_THREADS = 3
"""Timers, requests that wait for the rig, and the stop."""


class BenchParameters(NodeModel):
    """The node's parameters; rate of the line and ramp are the rig's where they are left out."""

    port: Annotated[str, Field(description="Serial device, pyserial URL, or 'emulated'.")] = (
        EMULATED
    )
    rig: Annotated[str, Field(description="Rig file: own path or a shipped file's name.")] = (
        SHIPPED_RIG
    )
    baud: Annotated[int, Field(ge=1200, le=1_000_000, description="Line rate.")]
    seed: Annotated[
        int, Field(ge=0, le=2**31 - 1, description="Seed of the emulated rig's noise.")
    ] = 0
    ramp_slope: Annotated[
        float,
        Field(
            ge=1e-4,
            le=1.0,
            description="Slope of run_ramp, at the motor.",
            json_schema_extra={"unit": "Nm/s", "read_only": False},
        ),
    ]
    ramp_end_torque: Annotated[
        float,
        Field(
            ge=0.0,
            description="Torque at which run_ramp ends, at the motor, up to the full scale of the converter.",
            json_schema_extra={"unit": "Nm", "read_only": False},
        ),
    ]

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is given, by name, and for the rest what the rig's file says.

        Raises:
            ConfigError: for a rig's file that is none, and a torque beyond its scale.
        """
        name = given.get("rig", SHIPPED_RIG)
        if not isinstance(name, str):
            raise ConfigError(f"parameter rig is {quoted(name)}; accepted: a text")
        rig = load_rig(resolve_config(name))
        ramps = rig.ramps
        content = {
            "baud": rig.baud,
            "ramp_slope": ramps.slopes[0],
            "ramp_end_torque": ramps.end_torque,
            **given,
        }
        torque = content["ramp_end_torque"]
        if isinstance(torque, float) and torque > rig.torque.dac_full_scale:
            most = f"{rig.torque.dac_full_scale:g}"
            raise ConfigError(
                f"parameter ramp_end_torque is {torque:g}; accepted: a number in [0, {most}]"
            )
        return content


class BenchNode:
    """Publishes the rig's readings and passes requests on to it; the line has a thread of its own.

    Readings go out as joint states and commands; a stamp is the firmware's tick on the computer's clock.
    """

    def __init__(self) -> None:
        with named_parameters():
            self.node = node = Node(
                "friction_bench", automatically_declare_parameters_from_overrides=True
            )
        own = NodeParameters(node)
        parameters = BenchParameters.of(own.values)
        own.declare(parameters)
        self.rig = load_rig(resolve_config(parameters.rig))
        port = parameters.port
        node.add_on_set_parameters_callback(self._check)
        self._states = node.create_publisher(JointState, "~/joint_states", QoSProfile(depth=10))
        self._commands = node.create_publisher(JointState, "~/joint_commands", QoSProfile(depth=10))
        self._previous: Sample | None = None
        self._epoch_ns = 0
        self._emulated: PtyRig | None = None
        if port == EMULATED:
            self._emulated = PtyRig(EmulatedRig(self.rig, parameters.seed))
            port = self._emulated.path
        log = node.get_logger()
        self._link = RigLink(
            lambda: SerialPort(port, parameters.baud),
            self.rig,
            self._publish,
            lambda text: log.error(one_line(text)),
            lambda text: log.info(one_line(f"{port}: {text}")),
        )
        self._timer = node.create_timer(_ALIVE_PERIOD, self._link.alive)
        publish_diagnostics(node, self._collect)
        # Requests that wait for the rig have a thread of their own; a stop never queues behind them.
        waiting = MutuallyExclusiveCallbackGroup()
        urgent = MutuallyExclusiveCallbackGroup()
        jobs = {
            "arm": (lambda: self._submit(RigClient.arm), "armed", waiting),
            "clear": (lambda: self._submit(RigClient.clear), "faults cleared, disarmed", waiting),
            "run_ramp": (lambda: self._submit(self._ramp), "ramp started", waiting),
            "load": (lambda: self._couple(True), "joint coupled", waiting),
            "unload": (lambda: self._couple(False), "joint taken off", waiting),
            "stop": (self._link.stop_rig, "stop sent", urgent),
        }
        self._services = [
            node.create_service(
                Trigger,
                f"~/{name}",
                partial(_answer, job, done),
                callback_group=group,
                qos_profile=REQUEST_QOS,
            )
            for name, (job, done, group) in jobs.items()
        ]
        own.refuse_unknown()

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            given = {parameter.name: parameter.value for parameter in parameters}
            BenchParameters.of(parameter_values(self.node) | given)
        except Rx90Error as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _publish(self, sample: Sample) -> None:
        previous = self._previous
        self._previous = sample
        if previous is None or sample.tick <= previous.tick:
            self._epoch_ns = self.node.get_clock().now().nanoseconds - round(
                sample.time * NANOSECONDS
            )
            previous = sample
        scale = self.rig.angle_step
        elapsed = sample.time - previous.time
        velocity = (sample.counts - previous.counts) * scale / elapsed if elapsed > 0.0 else 0.0
        state = JointState(
            name=[JOINT],
            position=[sample.counts * scale],
            velocity=[velocity],
            effort=[self.rig.measured_torque(sample.report.adc)],
        )
        command = JointState(name=[JOINT], effort=[self.rig.commanded_torque(sample.report.dac)])
        state.header.stamp = command.header.stamp = ros_time(
            self._epoch_ns + round(sample.time * NANOSECONDS)
        )
        self._states.publish(state)
        self._commands.publish(command)

    def _ramp(self, client: RigClient) -> None:
        client.start_ramp(
            *(self.node.get_parameter(name).value for name in ("ramp_slope", "ramp_end_torque"))
        )

    def _submit(self, job: Callable[[RigClient], None]) -> None:
        future = self._link.submit(job)
        try:
            future.result(_SERVICE_TIMEOUT)
        except TimeoutError:
            future.cancel()  # a request that was answered with a failure must not be carried out later
            raise RigLostError(f"the rig did not answer in {_SERVICE_TIMEOUT:g} s") from None

    def _couple(self, loaded: bool) -> None:
        if self._emulated is None:
            raise RigInputError("only an emulated rig can be coupled by a service")
        self._emulated.load(loaded)

    def _collect(self) -> tuple[bytes, str, dict[str, str]]:
        report = self._link.last
        bad, lost = self._link.damage
        values = {"bad frames": str(bad), "lost reports": str(lost)}
        if not self._link.connected or report is None:
            return DiagnosticStatus.ERROR, "no connection to the rig", values
        values |= {
            "state": report.state.name.lower(),
            "fault": fault_text(report.fault),
            "frames the rig refused": str(report.bad_frames),
        }
        if report.fault != Fault.NONE:
            return DiagnosticStatus.ERROR, fault_text(report.fault), values
        return DiagnosticStatus.OK, f"connected, {report.state.name.lower()}", values

    def tick_loop(self) -> None:
        """Serve the line until `stop`."""
        try:
            self._link.run()
        finally:
            if self._emulated is not None:
                self._emulated.close()

    def stop(self) -> None:
        """Take the torque away and end `tick_loop`."""
        self._link.close()


def _answer(
    job: Callable[[], None], done: str, _: Trigger.Request, response: Trigger.Response
) -> Trigger.Response:
    """Do a service's job, and answer `done`, or with the job's error."""
    try:
        job()
        response.success = True
        response.message = done
    except Rx90Error as error:
        response.success = False
        response.message = str(error)
    return response


def spin(args: Sequence[str]) -> None:
    """Run the node until it is interrupted."""
    spin_node(lambda: [BenchNode()], args, _THREADS)
