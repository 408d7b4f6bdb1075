"""The recorder as a process of its own, on real DDS."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import selectors
import signal
import struct
import subprocess
import sys
import termios
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_making import STORAGES
from processes import wait_until
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from warm_start import COLD

from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[3]
TIMEOUT_S = 60.0
TICKS = 4000
EVENTS = ("/rx90_controller/parameters", "/rx90_sim/parameters")


class Process:
    """A child process whose lines can be waited for."""

    def __init__(self, arguments: list[str], profiles: str | None = None, **options: Any) -> None:
        environment = os.environ | {
            "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
        }
        if profiles is not None:
            environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = profiles
        pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE) | options
        self.child = subprocess.Popen([sys.executable, *arguments], env=environment, cwd=ROOT, **pipes)
        self._read = b""

    def wait_for(self, beginning: str) -> str:
        """Return the next line of standard output that begins so."""
        assert self.child.stdout is not None
        deadline = time.monotonic() + TIMEOUT_S
        with selectors.DefaultSelector() as selector:
            selector.register(self.child.stdout, selectors.EVENT_READ)
            while True:
                while b"\n" in self._read:
                    line, self._read = self._read.split(b"\n", 1)
                    if line.startswith(beginning.encode()):
                        return line.decode()
                assert selector.select(deadline - time.monotonic()), f"no line {beginning!r} in time"
                chunk = os.read(self.child.stdout.fileno(), 65536)
                assert chunk, f"ended without a line {beginning!r}: {self.child.stderr and self.child.stderr.read()!r}"
                self._read += chunk

    def tell(self, line: str) -> None:
        """Write a line to standard input."""
        assert self.child.stdin is not None
        self.child.stdin.write(f"{line}\n".encode())
        self.child.stdin.flush()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.child.send_signal(number)

    def finish(self) -> tuple[int, str, str]:
        """Wait for the end; return exit code and what is left of standard output and error."""
        out, err = self.child.communicate(timeout=TIMEOUT_S)
        return self.child.returncode, (self._read + (out or b"")).decode(), (err or b"").decode()


Start = Callable[..., Process]


@pytest.fixture
def start(ros_domain: int, warm: None) -> Iterator[Start]:  # noqa: ARG001 - what they do is done
    """Return a function that starts a Python process; all are ended with the test."""
    processes: list[Process] = []

    def run(*arguments: str, **options: Any) -> Process:
        processes.append(Process(list(arguments), **options))
        return processes[-1]

    yield run
    for process in processes:
        process.child.kill()
        process.child.wait()


def start_recorder(start: Start, output: Path, *arguments: str, **options: Any) -> Process:
    """Start `rx90_bag record`."""
    return start("-m", "rx90_emulator", "rx90_bag", "record", "-o", str(output), *arguments, **options)


def start_publisher(start: Start, depth: int = 20_000, listeners: int = 1) -> Process:
    """Start the publisher, which waits for so many subscriptions before it publishes; its topics are there then."""
    publisher = start(str(Path(__file__).parent / "publisher.py"), str(depth), str(listeners))
    publisher.wait_for("there")
    return publisher


def catches_sigterm(process: Process) -> bool:
    """Return whether the process has installed a handler for SIGTERM."""
    status = Path(f"/proc/{process.child.pid}/status").read_text()
    mask = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(mask.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def record_suite(start: Start, folder: Path, storage: str) -> Path:
    """Record a run of the publisher with the default topics; return the bag."""
    publisher = start_publisher(start, listeners=len(SUITE_TOPICS))
    recorder = start_recorder(start, folder / "bag", "--storage", storage)
    recorder.wait_for(f"ready: all {len(SUITE_TOPICS)} topics are matched")
    publisher.tell(f"{TICKS} 4000")
    publisher.wait_for("done")
    recorder.signal(signal.SIGINT)
    code, out, err = recorder.finish()
    assert (code, err) == (0, "")
    counted = f"recorded {TICKS * 2 + TICKS // 4 * 7 + 6} messages of {len(SUITE_TOPICS)} topics to {folder / 'bag'}"
    assert f"{counted}; {TICKS // 500 * 7} repetitions" in out
    publisher.child.kill()
    return folder / "bag"


@pytest.mark.parametrize("storage", STORAGES)
def test_recording_is_complete_and_repeatable(tmp_path: Path, start: Start, storage: str) -> None:
    """At 12,000 messages per second all are in the bag at their stamp, once, on a busy machine in an equal file."""
    bag = record_suite(start, tmp_path / "quiet", storage)
    counts: Counter[str] = Counter()
    with AnyReader([bag]) as reader:
        for connection, log_ns, data in reader.messages():
            counts[connection.topic] += 1
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/robot_description":
                assert (message.data, log_ns) == ("<robot/>", 0)
            elif connection.topic in EVENTS:
                assert (message.stamp.nanosec, log_ns) == (200_000_000, 200_000_000)
            else:
                assert message.header.stamp.nanosec + message.header.stamp.sec * 10**9 == log_ns
        latched = next(c for c in reader.connections if c.topic == "/robot_description")
        assert latched.ext.offered_qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL  # type: ignore[union-attr]
    trajectories = ("/rx90_controller/joint_trajectory", "/rx90_controller/trajectory_accepted")
    once = dict.fromkeys(("/robot_description", "/temperatures", *trajectories, *EVENTS), 1)
    fast = dict.fromkeys(("/motor_states", "/motor_commands"), TICKS)
    assert counts == dict.fromkeys([f"/{t}" for t in SUITE_TOPICS], TICKS // 4) | fast | once
    told = [(c.node, c.name, c.value, c.stamp_ns) for c in summarise(bag).changes]
    assert told == [("/rx90_sim", "pace", "[2.0, 0.5]", 200_000_000)] * 2
    motors = read_joint_states(bag, "motor_states")
    assert motors.position is not None
    np.testing.assert_array_equal(motors.stamp_ns, np.arange(TICKS) * 250_000)
    np.testing.assert_array_equal(motors.position[3210], np.sin(np.arange(6) + 0.001 * 3210))
    if storage == "mcap":  # equal messages in equal order give equal files with either storage
        start("-c", "while True: pass")
        again = record_suite(start, tmp_path / "busy", storage)
        for file in bag.iterdir():
            assert (again / file.name).read_bytes() == file.read_bytes()


def test_a_loss_is_counted_and_fails(tmp_path: Path, start: Start) -> None:
    """Messages that a stopped recorder could not get are counted exactly, by topic, and make it fail."""
    publisher = start_publisher(start, depth=1)
    recorder = start_recorder(start, tmp_path / "bag", "motor_states", profiles="")  # small socket buffers
    recorder.wait_for("ready: all 1 topics")
    publisher.tell("1000 4000")
    publisher.wait_for("done")
    recorder.signal(signal.SIGSTOP)
    publisher.tell("4000 4000")
    publisher.wait_for("at 2000")  # far more than the recorder's socket and a publisher of depth 1 can keep
    recorder.signal(signal.SIGCONT)
    publisher.wait_for("done")
    publisher.tell("1000 1000")
    publisher.wait_for("done")
    recorder.signal(signal.SIGTERM)
    code, out, err = recorder.finish()
    assert code == 1
    received = int(out.split("recorded ")[1].split()[0])
    lost = int(err.split("lost: ")[1].split()[0])
    assert err == f"lost: {lost} messages of /motor_states (by publisher: {lost} of {received + lost})\n"
    assert lost > 0
    assert received + lost == 6000
    assert len(read_joint_states(tmp_path / "bag", "motor_states").stamp_ns) == received


def test_what_is_missing_is_reported_once(tmp_path: Path, start: Start) -> None:
    """A recorder names the topics it waits for, in its namespace, and records the others until SIGTERM."""
    publisher = start_publisher(start)
    recorder = start_recorder(start, tmp_path / "bag", "/joint_states", "elbow", "--ros-args", "-r", "__ns:=/cell")
    assert "/cell/elbow" in recorder.wait_for("waiting for")
    publisher.tell("4000 4000")
    publisher.wait_for("done")
    recorder.signal(signal.SIGTERM)
    code, out, err = recorder.finish()
    assert (code, err) == (0, "")
    repeated = "8 repetitions of the sample before are left out"
    assert out == f"recorded 1000 messages of 1 topics to {tmp_path / 'bag'}; {repeated}\n"
    assert len(read_joint_states(tmp_path / "bag", "joint_states").stamp_ns) == 1000


CONTROLLER = """
import sys
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from rx90_common.exchange.ros_start import prepare
prepare()
rclpy.init()
node = rclpy.create_node("controller")
commands = node.create_publisher(JointTrajectory, "c/joint_trajectory", 10)
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
accepted = node.create_publisher(JointTrajectory, "c/trajectory_accepted", latched)
for line in sys.stdin:
    value, where, frame = line.strip().split(",")
    message = JointTrajectory(joint_names=["joint_1"], points=[JointTrajectoryPoint(positions=[float(value)])])
    message.header.stamp.sec = 1
    if "commanded" in where:
        commands.publish(message)
    message.header.frame_id = frame
    message.header.stamp.sec = 2
    if "accepted" in where:
        accepted.publish(message)
    print("done", flush=True)
"""


def test_a_trajectory_that_did_not_come_fails(tmp_path: Path, start: Start, capsys: pytest.CaptureFixture[str]) -> None:
    """What the controller has accepted and nobody recorded is counted; goals, and what came before, are not asked for.

    The message of a sender that never learned of the recorder leaves no gap in any sequence number.
    """
    controller = start("-c", CONTROLLER)
    controller.tell("1,accepted,")
    controller.wait_for("done")
    topics = ("c/joint_trajectory", "c/trajectory_accepted")
    recorders = {name: start_recorder(start, tmp_path / name, *topics) for name in ("whole", "lacking")}
    for recorder in recorders.values():
        recorder.wait_for("ready: all 2 topics")
    for line in (
        "2,commanded accepted,",
        "2,commanded accepted,",
        "3,accepted,follow_joint_trajectory",
        "4,commanded,",
    ):
        controller.tell(line)
        controller.wait_for("done")
        time.sleep(0.1)  # latched: only the newest is kept for who has not got it
    recorders["whole"].signal(signal.SIGINT)
    assert recorders["whole"].finish()[::2] == (0, "")
    for line in ("2,accepted,", "5,accepted,"):
        controller.tell(line)
        controller.wait_for("done")
        time.sleep(0.1)
    recorders["lacking"].signal(signal.SIGINT)
    code, _, err = recorders["lacking"].finish()
    lacking = "not recorded: 2 trajectories of /c/joint_trajectory that the controller has accepted: sent before the"
    assert (code, err) == (1, f"{lacking} recording was ready, or lost\n")
    assert run("rx90_bag", ["info", str(tmp_path / "lacking")]) == 0
    lacks = "/c/joint_trajectory lacks 3 of the trajectories that the controller accepted: sent before the recording"
    assert lacks in capsys.readouterr().out


LISTENER = """
import rclpy, sys
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(JointTrajectory, "command", lambda _: None, 1)
node.create_subscription(JointState, "state", lambda _: None, 1)
sys.stdin.read()
"""


def test_topics_that_are_only_listened_to(tmp_path: Path, start: Start) -> None:
    """A command that a node listens to can be recorded before anybody sends one; a state needs its publisher."""
    start("-c", LISTENER)
    command = start_recorder(start, tmp_path / "command", "command")
    state = start_recorder(start, tmp_path / "state", "state")
    command.wait_for("ready: all 1 topics")
    state.wait_for("waiting for /state")
    for recorder, name in ((command, "command"), (state, "state")):
        recorder.signal(signal.SIGINT)
        code, out, err = recorder.finish()
        assert (code, err) == (1, f"nothing recorded: no message came on {name}\n")
        assert "ready" not in out


@pytest.mark.parametrize(
    ("moment", "storage"), [("handler", "mcap"), ("folder", "mcap"), ("folder", "sqlite3"), ("waiting", "sqlite3")]
)
def test_signal_while_starting(
    tmp_path: Path, start: Start, storage: str, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal at any moment of the start leaves a valid bag; that it is empty is a line and exit code 1."""
    if moment == "handler":  # in the midst of the slow imports
        monkeypatch.setattr(subprocess, "Popen", COLD)
    recorder = start_recorder(start, tmp_path / "bag", "joint_states", "-s", storage)
    if moment == "handler":
        wait_until(lambda: catches_sigterm(recorder), "the handler")
    elif moment == "folder":
        wait_until((tmp_path / "bag").exists, "the folder")
    else:
        recorder.wait_for("waiting for")
    recorder.signal(signal.SIGINT)
    recorder.signal(signal.SIGINT)
    code, _, err = recorder.finish()
    assert (code, err) == (1, "nothing recorded: no message came on joint_states\n")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["-o", "taken"], "taken exists; accepted: a new name"),
        (["-o", "new", "joint states"], "topic 'joint states': no name that ROS accepts"),
        (["-o", "new", "a", "/a"], "topic /a stands twice; accepted: each topic once"),
        (["-o", "new", "a", "--ros-args", "nonsense"], "ROS arguments --ros-args nonsense: refused"),
        (["-o", "taken/notes.txt/bag"], "taken/notes.txt/bag: cannot be written (Not a directory)"),
    ],
)
def test_mistakes_leave_nothing_behind(tmp_path: Path, start: Start, arguments: list[str], complaint: str) -> None:
    """A mistake gives exit code 2 and a line with the offending value; nothing is made or overwritten."""
    place = tmp_path / "place"
    (place / "taken").mkdir(parents=True)
    (place / "taken" / "notes.txt").write_text("mine")
    for name in ("taken", "new"):
        arguments = [argument.replace(name, str(place / name)) for argument in arguments]
    code, out, err = start("-m", "rx90_emulator", "rx90_bag", "record", *arguments).finish()
    assert (code, out) == (2, "")
    assert complaint.replace("taken", str(place / "taken")) in err.splitlines()[-1]
    assert "Traceback" not in err
    assert [p.name for p in place.rglob("*")] == ["taken", "notes.txt"]


HALF = "; what was written before stays, and rx90_bag info says how much of it is whole"

CRAMPED = """
import resource, sys
from rx90_emulator.cli.frame import run
resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, resource.RLIM_INFINITY))
sys.exit(run('rx90_bag', sys.argv[1:]))
"""


def start_recorded_by(program: str, bag: Path, start: Start) -> tuple[Process, Process]:
    """Return a publisher and a program that records what it publishes, both ready."""
    publisher = start_publisher(start)
    recorder = start("-c", program, "record", "-o", str(bag), "motor_states")
    recorder.wait_for("ready: all 1 topics")
    return publisher, recorder


def test_a_disk_that_takes_no_more_is_a_failure(tmp_path: Path, start: Start) -> None:
    """When the system refuses to write on, the recorder ends with one line and exit code 3; the bag's start stays."""
    publisher, recorder = start_recorded_by(CRAMPED, tmp_path / "bag", start)
    publisher.tell("20000 4000")
    code, _, err = recorder.finish()
    assert (code, err.strip()) == (3, f"rx90_bag: {tmp_path / 'bag'}: cannot be written (File too large){HALF}")
    with pytest.raises(BagError, match=r"bag\.mcap is cut off"), BagReader(tmp_path / "bag"):
        pass


STUCK = """
import sys, threading
from rx90_common.exchange.ros_start import prepare
prepare()
from rx90_common.bags.recorder import recording, stream
from rx90_emulator.cli.frame import execute
take = stream.Stream.take
def stuck(self):
    taken = take(self)
    if self.counter.received == 400 and not len(taken.messages):
        print("stuck", flush=True)
        threading.Event().wait()
    return taken
stream.Stream.take = stuck
recording._MAX_END_S = 0.5
sys.exit(execute('rx90_bag', sys.argv[1:]))
"""


def test_a_middleware_that_does_not_return_ends_the_recorder(tmp_path: Path, start: Start) -> None:
    """When a call into DDS never returns, Ctrl-C still leaves a whole bag; the recorder says so and ends with 3."""
    publisher, recorder = start_recorded_by(STUCK, tmp_path / "bag", start)
    publisher.tell("400 4000")
    recorder.wait_for("stuck")
    recorder.signal(signal.SIGINT)
    code, out, err = recorder.finish()
    assert (code, out) == (3, "")
    assert err.startswith("rx90_bag: the message reader did not end within 0.5 s (it is in ")
    assert err.count("\n") == 1
    assert len(read_joint_states(tmp_path / "bag", "motor_states").stamp_ns) == 400


def test_status_on_a_terminal(tmp_path: Path, start: Start) -> None:
    """On a terminal the recorder shows the number of messages and the simulated time."""
    publisher = start_publisher(start)
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("4H", 24, 100, 0, 0))
    recorder = start_recorder(start, tmp_path / "bag", "motor_states", stderr=terminal)
    recorder.wait_for("ready: all 1 topics")
    publisher.tell("4001 0")
    shown = ""
    while "4.00k msgs" not in shown or "t = 1.000 s" not in shown:
        readable, _, _ = select.select([controller], [], [], TIMEOUT_S)
        assert readable, shown
        shown += os.read(controller, 65536).decode()
    recorder.signal(signal.SIGINT)
    assert recorder.finish()[0] == 0
    os.close(terminal)
    os.close(controller)


def test_a_recorder_that_did_not_run_for_long_reports_it_and_fails(tmp_path: Path, start: Start) -> None:
    """After a stop beyond the lease, in which nobody sent, the loss is not known: that is reported, and it fails."""
    publisher = start_publisher(start, depth=1)
    recorder = start_recorder(start, tmp_path / "bag", "motor_states")
    recorder.wait_for("ready: all 1 topics")
    publisher.tell("100 1000")
    publisher.wait_for("done")
    stopped = time.monotonic()
    recorder.signal(signal.SIGSTOP)
    wait_until(lambda: time.monotonic() > stopped + 4.5, "a stop that is too long")
    recorder.signal(signal.SIGCONT)
    recorder.signal(signal.SIGTERM)
    code, _, err = recorder.finish()
    assert code == 1
    assert "lost: an unknown number of messages, in " in err
