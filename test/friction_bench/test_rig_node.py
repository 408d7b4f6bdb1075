"""The friction_bench node as a process, over DDS, on an emulated rig behind a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from friction_bench.emulated import EmulatedRig
from friction_bench.pty_rig import PtyRig
from friction_bench.rig import Rig

pytestmark = pytest.mark.ros
START = "import sys; from friction_bench.node import main; sys.exit(main(sys.argv[1:]))"


class Session:
    """A rig, the node that serves it, and a client, on the domain of the environment."""

    def __init__(self, rig: Rig, folder: Path) -> None:
        self.pty = PtyRig(EmulatedRig(rig, 1), folder / "rig")
        self.log = folder / "log"
        self.arguments = ["--ros-args", "-p", f"port:={folder / 'rig'}"]
        self.start()
        self.context = Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("test_client", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states: list[JointState] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.node.create_subscription(JointState, "friction_bench/joint_states", self.states.append, 100)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)

    def start(self) -> None:
        """Start the node."""
        with self.log.open("a") as stream:
            self.process = subprocess.Popen(
                [sys.executable, "-c", START, *self.arguments], stdout=stream, stderr=stream
            )

    def until(self, condition: Callable[[], bool], timeout: float = 40.0) -> None:
        """Listen until a condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, self.log.read_text()
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, name: str) -> Any:
        """Call a service and return its answer."""
        client = self.node.create_client(Trigger, f"friction_bench/{name}")
        self.until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        self.until(answer.done)
        return answer.result()

    def insist(self, *names: str) -> None:
        """Call services in a row; again from the first one where the machine stood still and the rig went off."""
        for _ in range(10):
            if all(self.call(name).success for name in names):
                return
            self.call("stop")
            self.call("clear")
        pytest.fail(f"{names} never succeeded:\n{self.log.read_text()}")

    def close(self) -> None:
        """End the node by its own pid, the rig and the client."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.pty.close()
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def session(rig: Rig, tmp_path: Path, ros_domain: int) -> Iterator[Session]:  # noqa: ARG001
    """Return a node that reports its rig, on a domain of its own."""
    made = Session(rig, tmp_path)
    try:
        made.until(lambda: len(made.states) > 3)
        yield made
    finally:
        made.close()


def test_ramp_runs_and_stops_by_service(session: Session) -> None:
    """Arm, ramp and stop work over services; states carry the firmware's 20 ms; a stop ends the torque."""
    assert not session.call("run_ramp").success
    session.insist("arm", "run_ramp")
    session.until(lambda: session.states[-1].effort[0] > 0.01)
    answer = session.call("stop")
    assert answer.success
    session.until(lambda: not session.pty.emulated.board.stage_on)
    stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in session.states]
    steps = {b - a for a, b in pairwise(stamps)}
    assert all(step % 20_000_000 == 0 for step in steps)
    assert all(len(s.position) == len(s.velocity) == len(s.effort) == 1 for s in session.states)


def test_fault_stands_on_diagnostics_until_cleared(session: Session) -> None:
    """A frozen node loses the torque; afterwards the fault is on /diagnostics, and clear and arm work."""
    session.insist("arm")
    os.kill(session.process.pid, signal.SIGSTOP)
    session.until(lambda: not session.pty.emulated.board.stage_on)
    os.kill(session.process.pid, signal.SIGCONT)
    session.until(lambda: bool(session.diagnostics) and "silent" in session.diagnostics[-1].status[0].message)
    assert not session.call("arm").success
    session.insist("clear", "arm")


def test_parameters_that_are_no_torque_are_refused_in_one_line(session: Session) -> None:
    """NaN, infinity and a text as slope or end torque are refused by parameter or by service; the node lives on."""
    setter = session.node.create_client(SetParameters, "friction_bench/set_parameters")
    session.until(setter.service_is_ready)
    for value in (
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float("nan")),
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float("inf")),
        ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="steep"),
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.19),
    ):
        for name in ("ramp_slope", "ramp_end_torque"):
            request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
            answer = setter.call_async(request)
            session.until(answer.done)
            taken = answer.result().results[0].successful
            if taken and (name, value.double_value) != ("ramp_slope", 0.19):
                refused = session.call("run_ramp")
                assert not refused.success
                assert "accepted" in refused.message
            default = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.05)
            back = setter.call_async(SetParameters.Request(parameters=[Parameter(name=name, value=default)]))
            session.until(back.done)
    session.insist("arm", "run_ramp")
    assert "Traceback" not in session.log.read_text()


def test_node_that_is_killed_loses_the_torque_and_can_be_started_again(session: Session) -> None:
    """After kill -9 in a ramp the firmware takes the torque away, and a new node finds the fault latched."""
    session.insist("arm", "run_ramp")
    session.process.kill()
    session.until(lambda: not session.pty.emulated.board.stage_on)
    session.process.wait()
    session.start()
    session.until(lambda: bool(session.diagnostics) and "silent" in session.diagnostics[-1].status[0].message)
    assert not session.call("arm").success
    session.insist("clear", "arm")


def test_interrupt_leaves_the_rig_without_torque(session: Session) -> None:
    """Ctrl-C ends the node with 0 and the rig disarmed, by a stop and not by the watchdog."""
    session.insist("arm")
    session.process.send_signal(signal.SIGINT)
    assert session.process.wait(20) == 0
    session.until(lambda: not session.pty.emulated.board.stage_on)
    assert "Traceback" not in session.log.read_text()
