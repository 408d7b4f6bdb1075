"""The friction_bench node as a process, over DDS, on an emulated rig behind a pseudo-terminal."""

import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rig_bench import PatientRig
from ros_client import Client
from std_srvs.srv import Trigger

from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.rig_file import Rig
from rx90_common.process.children import TIMEOUT, executable

pytestmark = pytest.mark.ros

FAR_FROM_THE_END = 100  # a code that the ramp of `run_ramp` goes beyond


class Session:
    def __init__(self, rig: Rig, folder: Path, namespace: str = "", *arguments: str) -> None:
        self.name = f"{namespace}/friction_bench"
        self.pty = PatientRig(EmulatedRig(rig, 1), folder / "rig")
        self.log = folder / "log"
        self.arguments = ["--ros-args", "-p", f"port:={folder / 'rig'}", *arguments]
        self.start()
        self.client = Client()
        self.states = self.client.listen(f"{self.name}/joint_states")
        self.diagnostics = self.client.listen("/diagnostics", DiagnosticArray)

    def start(self) -> None:
        with self.log.open("a") as stream:
            self.process = subprocess.Popen(executable("friction_bench", *self.arguments), stdout=stream, stderr=stream)

    def until(self, condition: Callable[[], bool]) -> None:
        self.client.spin_until(condition, f"what the node of {self.log} should do")

    def call(self, name: str) -> Any:
        return self.client.asking.call(Trigger, f"{self.name}/{name}", Trigger.Request())

    def heard(self, count: int) -> None:
        self.until(lambda: len(self.states) >= count)
        stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in self.states]
        assert all(b > a and (b - a) % 20_000_000 == 0 for a, b in pairwise(stamps))

    @property
    def stage_on(self) -> bool:
        return self.pty.emulated.board.stage_on

    def fault_is_latched_until_cleared(self) -> None:
        self.until(lambda: bool(self.diagnostics) and "silent" in self.diagnostics[-1].status[0].message)
        assert not self.call("arm").success
        self.insist("clear", "arm")

    def insist(self, *names: str) -> None:
        """Call services in a row; again from the first one where the machine stood still and the rig went off."""
        for _ in range(10):
            if all(self.call(name).success for name in names):
                return
            self.call("stop")
            self.call("clear")
        pytest.fail(f"{names} never succeeded:\n{self.log.read_text()}")

    def lose_the_host(self, signal_number: signal.Signals) -> None:
        """Send the node, which has armed the rig, a signal that silences it; the rig takes that for what it is."""
        for _ in range(10):
            with self.pty.standing_still():  # so that the ramp, if there is one, cannot come to its end before
                if self.stage_on and self.pty.emulated.board.dac < FAR_FROM_THE_END:
                    self.pty.patient = False
                    self.process.send_signal(signal_number)
                    return
            self.insist("arm", "run_ramp")
        pytest.fail(f"the rig never kept its torque:\n{self.log.read_text()}")

    def ramp(self, until: Callable[[], bool]) -> None:
        """Run a ramp until a condition holds; again where the machine stood still and the rig went off."""
        for _ in range(10):
            self.insist("arm", "run_ramp")
            self.until(lambda: until() or not self.stage_on)
            self.until(lambda: self.stage_on or self.rests())
            if until():
                return
        pytest.fail(f"the ramp never came there:\n{self.log.read_text()}")

    def rests(self) -> bool:
        """Return whether it has stood still for 0.1 s, by states that are no older than the rig's last motion."""
        rig = self.pty.emulated
        angles = {state.position[0] for state in self.states[-6:]}
        return len(angles) == 1 and abs(angles.pop() - rig.plant.angle) <= rig.rig.angle_step

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.pty.close()
        self.client.close()


@pytest.fixture
def make(rig: Rig, tmp_path: Path, ros_domain: int, warm: None) -> Iterator[Callable[..., Session]]:  # noqa: ARG001 - a domain of its own
    with ExitStack() as stack:

        def start(side: str = "") -> Session:
            folder = tmp_path / f"rig{side}"
            folder.mkdir()
            others = ["-r", f"__ns:=/{side}", "-p", "ramp_slope:=0.3"] if side else []
            made = Session(rig, folder, f"/{side}" if side else "", *others)
            stack.callback(made.close)
            made.heard(4)
            return made

        yield start


@pytest.fixture
def session(make: Callable[..., Session]) -> Session:
    return make()


def test_two_rigs_beside_each_other_know_nothing_of_each_other(make: Callable[..., Session]) -> None:
    """Two nodes in namespaces run a ramp each; while one turns the other rests: each publishes its own rig's angle."""
    pair = make("left"), make("right")
    for turning, resting in (pair, pair[::-1]):
        begins_at, heard = resting.states[-1].position[0], len(resting.states)
        from_here = turning.states[-1].position[0] + 1.0
        turning.ramp(lambda: not turning.stage_on and turning.states[-1].position[0] > from_here)  # noqa: B023
        assert not resting.stage_on
        resting.heard(heard + 10)
        assert {state.position[0] for state in resting.states[heard:]} == {begins_at}
        turning.until(turning.rests)


def test_services_and_parameters_move_the_rig_and_a_frozen_node_does_not(session: Session) -> None:
    """Arm, ramp and stop work over services; states carry the firmware's 20 ms; a stop ends the torque."""
    assert not session.call("run_ramp").success
    session.ramp(lambda: session.states[-1].effort[0] > 0.01)
    assert session.call("stop").success
    session.until(lambda: not session.stage_on)
    session.heard(len(session.states) + 4)
    assert all(len(s.position) == len(s.velocity) == len(s.effort) == 1 for s in session.states)
    assert session.client.set_parameters("friction_bench", ramp_end_torque=0.19) == [""]
    assert "accepted by the firmware" in session.call("run_ramp").message
    assert session.client.set_parameters("friction_bench", ramp_end_torque=0.15) == [""]
    session.insist("arm")
    session.lose_the_host(signal.SIGSTOP)
    session.until(lambda: not session.stage_on)
    session.pty.patient = True
    session.process.send_signal(signal.SIGCONT)
    session.fault_is_latched_until_cleared()
    assert session.stage_on
    session.process.send_signal(signal.SIGINT)
    assert session.process.wait(TIMEOUT) == 0
    session.until(lambda: not session.stage_on)
    assert "Traceback" not in session.log.read_text()


def test_node_that_is_killed_loses_the_torque_and_can_be_started_again(session: Session) -> None:
    """After kill -9 in a ramp the firmware takes the torque away, and a new node finds the fault latched."""
    session.insist("arm", "run_ramp")
    session.lose_the_host(signal.SIGKILL)
    session.until(lambda: not session.stage_on)
    session.pty.patient = True
    session.process.wait()
    session.start()
    session.fault_is_latched_until_cleared()
