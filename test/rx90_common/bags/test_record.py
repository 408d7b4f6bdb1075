"""The recorder as a process of its own, on real DDS, and types that are none of the common interfaces."""

import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import wait_until
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_client import own_node
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from warm_start import COLD

from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.bags.recorder import stream
from rx90_common.bags.topics import SUITE_TOPICS
from rx90_common.bags.writing import BagWriter
from rx90_common.base.errors import BagError
from rx90_common.exchange import message_types
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.ros_start import prepare
from rx90_common.process.interrupts import StopRequest
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.recorded_setup import read_changes

TIMEOUT_S = 60.0
TICKS = 2000
EVENTS = ("rx90_controller/parameters", "rx90_sim/parameters")
FAST = ("motor_states", "motor_commands")
TRAJECTORIES = ("rx90_controller/joint_trajectory", "rx90_controller/trajectory_accepted")
SLOW = tuple(name for name in SUITE_TOPICS if name not in (*EVENTS, *FAST, *TRAJECTORIES, "robot_description"))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NAMES = tuple(f"joint_{i}" for i in range(1, 7))


class Process:
    """A child process whose lines can be waited for; one that stands still is killed."""

    def __init__(self, arguments: list[str], **options: Any) -> None:
        pipes: dict[str, Any] = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE) | options
        self.child = subprocess.Popen([sys.executable, *arguments], text=True, **pipes)
        self._limit = threading.Timer(5 * TIMEOUT_S, self.child.kill)
        self._limit.start()

    def wait_for(self, beginning: str) -> str:
        for line in self.child.stdout or ():
            if line.startswith(beginning):
                return line
        raise AssertionError(f"ended without a line {beginning!r}: {self.finish()}")

    def finish(self, number: signal.Signals | None = None) -> tuple[int, str, str]:
        if number is not None:
            self.child.send_signal(number)
        out, err = ("" if stream is None else stream.read() for stream in (self.child.stdout, self.child.stderr))
        self._limit.cancel()
        return self.child.wait(TIMEOUT_S), out, err


Start = Callable[..., Process]


@pytest.fixture
def start(ros_domain: int, warm: None) -> Iterator[Start]:  # noqa: ARG001 - what they do is done
    processes: list[Process] = []

    def run(*arguments: str, **options: Any) -> Process:
        processes.append(Process(list(arguments), **options))
        return processes[-1]

    yield run
    for process in processes:
        process.child.kill()
        process.finish()


def record(start: Start, output: Path, *arguments: str, ready: int = 0, **options: Any) -> Process:
    recorder = start("-m", "rx90_emulator", "bag", "record", "-o", str(output), *arguments, **options)
    if ready:
        recorder.wait_for(f"ready: all topics are matched, recording {ready} topic")
    return recorder


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    prepare()
    with own_node("publisher", ros_domain) as node:
        yield node


class Suite:
    def __init__(self, node: Node, depth: int = 20_000) -> None:
        from rcl_interfaces.msg import ParameterEvent
        from rclpy.parameter import Parameter

        kinds = {"robot_description": String} | dict.fromkeys(EVENTS, ParameterEvent)
        kinds |= dict.fromkeys(TRAJECTORIES, JointTrajectory)
        latched = (*EVENTS, "robot_description", "rx90_controller/trajectory_accepted")
        self.publishers = {
            name: node.create_publisher(kinds.get(name, JointState), name, LATCHED if name in latched else depth)
            for name in SUITE_TOPICS
        }
        self.publishers["robot_description"].publish(String(data="<robot/>"))
        event = ParameterEvent(
            node="/rx90_sim", changed_parameters=[Parameter("pace", value=[2.0, 0.5]).to_parameter_msg()]
        )
        event.stamp.nanosec = 200_000_000
        for topic in EVENTS:
            self.publishers[topic].publish(event)
        self._codec, self._tick = JointStateCodec(NAMES), 0

    def publish(
        self, ticks: int, rate: float, topics: Sequence[str] = ("motor_states",), *, acknowledged: bool = True
    ) -> None:
        """Publish further ticks at a rate in Hz, 0: as fast as it goes, once the recorder is at each of its topics."""
        each = self.publishers.values()
        for topic in topics:
            wait_until(lambda one=self.publishers[topic]: one.get_subscription_count() > 0, f"a listener of {topic}")  # type: ignore[misc]
        message = JointTrajectory(joint_names=list(NAMES))
        message.header.stamp.nanosec = 100_000_000
        for name in TRAJECTORIES:
            self.publishers[name].publish(message)
        fast, slow = ([self.publishers[name].publish for name in names if name in topics] for names in (FAST, SLOW))
        begin = time.monotonic()
        for k, tick in enumerate(range(self._tick, self._tick + ticks)):
            if rate:
                time.sleep(max(0.0, begin + k / rate - time.monotonic()))
            values = np.sin(np.arange(6) + 0.001 * tick)
            raw = self._codec.encode(tick * 250_000, values, -values, 2 * values)
            # Every 500th once more, as from a simulation in which time stands still.
            for send in (fast if tick % 4 else fast + slow) + (slow if tick % 500 == 0 else []):
                send(raw)
        self._tick += ticks
        assert not acknowledged or all(one.wait_for_all_acked(Duration(seconds=TIMEOUT_S)) for one in each)


def record_suite(start: Start, ros_domain: int, folder: Path) -> Path:
    with own_node("suite", ros_domain) as node:
        suite = Suite(node)
        recorder = record(start, folder / "bag", ready=len(SUITE_TOPICS))
        suite.publish(TICKS, 4000, SUITE_TOPICS)
        code, out, err = recorder.finish(signal.SIGINT)
    assert code == 0
    assert [line for line in err.splitlines() if "compiling the numerical kernels" not in line] == []
    count = TICKS * len(FAST) + TICKS // 4 * len(SLOW) + 5
    counted = f"recorded {count} messages of {len(SUITE_TOPICS)} topics to {folder / 'bag'}"
    left = f"left out: {TICKS // 500 * len(SLOW)} repetitions of the sample before"
    assert f"{counted}; {left}" in out
    return folder / "bag"


@pytest.mark.ros
def test_recording_is_complete_and_repeatable(tmp_path: Path, start: Start, ros_domain: int) -> None:
    """At 12,000 messages per second all are in the bag at their stamp, once, on a busy machine in an equal file."""
    prepare()
    bag = record_suite(start, ros_domain, tmp_path / "quiet")
    counts: Counter[str] = Counter()
    with AnyReader([bag]) as reader:
        for connection, log_ns, data in reader.messages():
            name = connection.topic.removeprefix("/")
            counts[name] += 1
            message: Any = reader.deserialize(data, connection.msgtype)
            if name == "robot_description":
                assert (message.data, log_ns) == ("<robot/>", 0)
                continue
            stamp = message.stamp if name in EVENTS else message.header.stamp
            assert stamp.nanosec + stamp.sec * 10**9 == log_ns
            assert name not in EVENTS or log_ns == 200_000_000
        latched = next(c for c in reader.connections if c.topic == "/robot_description")
        assert latched.ext.offered_qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL  # type: ignore[union-attr]
    assert counts == dict.fromkeys(SUITE_TOPICS, 1) | dict.fromkeys(FAST, TICKS) | dict.fromkeys(SLOW, TICKS // 4)
    assert read_changes(bag) == ["pace", "pace"]
    motors = read_joint_states(bag, "motor_states")
    np.testing.assert_array_equal(motors.stamp_ns, np.arange(TICKS) * 250_000)
    np.testing.assert_array_equal(motors.position[1210], np.sin(np.arange(6) + 0.001 * 1210))
    start("-c", "while True: pass")
    again = record_suite(start, ros_domain, tmp_path / "busy")
    for file in bag.iterdir():
        assert (again / file.name).read_bytes() == file.read_bytes()


@pytest.mark.ros
def test_a_loss_is_counted_and_fails(tmp_path: Path, start: Start, node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages that a stopped recorder could not get are counted exactly, by topic, and make it fail."""
    suite = Suite(node, depth=1)
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "")  # small buffers of the sockets
    recorder = record(start, tmp_path / "bag", "motor_states", ready=1)
    suite.publish(1000, 4000)
    recorder.child.send_signal(signal.SIGSTOP)
    suite.publish(2000, 4000, acknowledged=False)  # far more than the recorder's socket and a depth of 1 can keep
    recorder.child.send_signal(signal.SIGCONT)
    suite.publish(2000, 4000)
    suite.publish(1000, 1000)
    code, out, err = recorder.finish(signal.SIGTERM)
    assert code == 1
    received = int(out.split("recorded ")[1].split()[0])
    lost = int(err.split("lost: ")[1].split()[0])
    assert err == f"lost: {lost} messages of /motor_states (by publisher: {lost} of {received + lost})\n"
    assert lost > 0
    assert received + lost == 6000
    assert len(read_joint_states(tmp_path / "bag", "motor_states").stamp_ns) == received


@pytest.mark.ros
def test_what_is_missing_is_reported_once(tmp_path: Path, start: Start, node: Node) -> None:
    """A recorder names the topics it waits for, in its namespace, and records the others until SIGTERM."""
    suite = Suite(node)
    recorder = record(start, tmp_path / "bag", "/joint_states", "elbow", "--ros-args", "-r", "__ns:=/cell")
    assert "/cell/elbow" in recorder.wait_for("waiting for")
    suite.publish(TICKS, 4000, ["joint_states"])
    repeated = "left out: 4 repetitions of the sample before"
    out = f"recorded 500 messages of 1 topic to {tmp_path / 'bag'}; {repeated}\n"
    empty = "not recorded: no message came on /cell/elbow\n"
    assert recorder.finish(signal.SIGTERM) == (1, out, empty)
    assert len(read_joint_states(tmp_path / "bag", "joint_states").stamp_ns) == 500


@pytest.mark.ros
def test_topics_that_are_only_listened_to(tmp_path: Path, start: Start, node: Node) -> None:
    """A command that a node listens to can be recorded before anybody sends one; a state needs its publisher."""
    node.create_subscription(JointTrajectory, "command", lambda _: None, 1)
    node.create_subscription(JointState, "state", lambda _: None, 1)
    command, state = (record(start, tmp_path / name, name) for name in ("command", "state"))
    command.wait_for("ready: all topics")
    state.wait_for("waiting for /state")
    for recorder, name in ((command, "command"), (state, "state")):
        assert recorder.finish(signal.SIGINT)[::2] == (1, f"nothing recorded: no message came on /{name}\n")
        with AnyReader([tmp_path / name]) as reader:
            assert reader.message_count == 0


@pytest.mark.ros
def test_a_listener_that_may_miss_messages_does_not_make_the_recorder_miss_them(node: Node) -> None:
    """A topic may be known by a best-effort listener before its reliable publisher is."""
    hasty = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(JointState, "motor_states", lambda _: None, hasty)
    wait_until(lambda: bool(node.get_subscriptions_info_by_topic("/motor_states")), "the listener")
    streams = stream.Streams(node, ["motor_states"])
    streams.discover()
    (recorded,) = streams
    assert recorded.qos.reliability is QosReliability.RELIABLE


@pytest.mark.ros
@pytest.mark.parametrize("moment", ["imports", "folder"])
def test_signal_while_starting(tmp_path: Path, start: Start, moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal early in the start leaves a valid bag, too; that it is empty is a line and exit code 1."""

    def imports() -> bool:
        return "_rclpy_pybind11" in Path(f"/proc/{recorder.child.pid}/maps").read_text(encoding="utf-8")

    if moment == "imports":
        monkeypatch.setattr(subprocess, "Popen", COLD)
    recorder = record(start, tmp_path / "bag", "joint_states")
    wait_until(imports if moment == "imports" else (tmp_path / "bag").exists, f"the {moment}")
    recorder.child.send_signal(signal.SIGINT)
    assert recorder.finish(signal.SIGINT)[::2] == (1, "nothing recorded: no message came on /joint_states\n")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 0


CRAMPED = """
import resource, sys
from rx90_emulator.cli.frame import run
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
sys.exit(run('rx90 bag', sys.argv[1:]))
"""


@pytest.mark.ros
def test_a_disk_that_takes_no_more_is_a_failure(tmp_path: Path, start: Start, node: Node) -> None:
    """When the system refuses to write on, the recorder ends with one line and exit code 3; the bag's start stays."""
    suite = Suite(node)
    recorder = start("-c", CRAMPED, "record", "-o", str(tmp_path / "bag"), "motor_states")
    recorder.wait_for("ready: all topics")
    suite.publish(8000, 0, acknowledged=False)  # the recorder holds the newest second
    code, _, err = recorder.finish()
    assert (code, err.strip()) == (3, f"rx90 bag: {tmp_path / 'bag'}: cannot be written (File too large)")
    with pytest.raises(BagError, match=r"bag\.mcap is cut off"), BagReader(tmp_path / "bag" / "bag.mcap"):
        pass


STATE = "control_msgs/msg/JointTrajectoryControllerState"
# Of the real package's definition (control_msgs 5.8.0), by Jazzy's rosidl_generator_type_description.
STATE_HASH = "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
OTHERS = {"/joint_states": 3, "/tf_static": 1, "/tf": 4, "/rx90_controller/controller_state": 3, "/diagnostics": 3}


@pytest.mark.ros
@pytest.mark.usefixtures("needs_action", "needs_tf")
def test_other_types_are_recorded(tmp_path: Path, start: Start, node: Node, capsys: pytest.CaptureFixture[str]) -> None:
    """Rosbags, info and compare read them, at their own stamps; latched ones from before are there, still latched."""
    from control_msgs.msg import JointTrajectoryControllerState
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import TransformStamped
    from tf2_msgs.msg import TFMessage

    fixed = node.create_publisher(TFMessage, "tf_static", LATCHED)
    kinds = {"tf": TFMessage, "joint_states": JointState, "diagnostics": DiagnosticArray,
             "rx90_controller/controller_state": JointTrajectoryControllerState}  # fmt: skip
    publishers = [node.create_publisher(kind, name, 9) for name, kind in kinds.items()]
    fixed.publish(TFMessage(transforms=[TransformStamped(child_frame_id="tool0")]))
    recorder = record(start, tmp_path / "bag", *OTHERS, ready=5)
    # A publisher may hear of a listener later than the listener of it.
    wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers), "the recorder")
    for nanosec in (10_000_000, 20_000_000, 30_000_000):
        clock = JointState(name=["a"], position=[0.5])
        state = JointTrajectoryControllerState(joint_names=["a", "b"], speed_scaling_factor=0.75)
        state.reference.positions = [0.25, nanosec * 1.0]
        clock.header.stamp.nanosec = state.header.stamp.nanosec = nanosec
        report = DiagnosticArray()
        report.header.stamp.sec = 1_700_000_000  # of the wall clock: dated when it comes, it does not stretch the bag
        one = TransformStamped(child_frame_id="link_1", header=state.header)
        messages = (TFMessage(transforms=[one, one]), clock, report, state)
        for publisher, message in zip(publishers, messages, strict=True):
            publisher.publish(message)
    publishers[0].publish(TFMessage())
    assert all(publisher.wait_for_all_acked(Duration(seconds=TIMEOUT_S)) for publisher in publishers)
    assert recorder.finish(signal.SIGINT)[0] == 0
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.end_time < 1_000_000_000
        for connection, log_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((log_ns, reader.deserialize(data, connection.msgtype)))
        connections = {connection.topic: connection for connection in reader.connections}
    assert {topic: len(messages) for topic, messages in found.items()} == OTHERS
    for topic in ("/rx90_controller/controller_state", "/tf", "/joint_states"):
        assert [log_ns for log_ns, _ in found[topic][:3]] == [10_000_000, 20_000_000, 30_000_000]
    state = found["/rx90_controller/controller_state"][1][1]
    assert (state.joint_names, state.speed_scaling_factor) == (["a", "b"], 0.75)
    assert state.reference.positions.tolist() == [0.25, 2e7]
    assert [one.child_frame_id for _, message in found["/tf"] for one in message.transforms] == ["link_1"] * 6
    assert found["/tf_static"][0][1].transforms[0].child_frame_id == "tool0"
    durability = {topic: kind.ext.offered_qos_profiles[0].durability for topic, kind in connections.items()}  # type: ignore[union-attr]
    assert [topic for topic, kind in durability.items() if kind is QosDurability.TRANSIENT_LOCAL] == ["/tf_static"]
    assert connections["/rx90_controller/controller_state"].digest == STATE_HASH
    assert run("rx90 bag", ["info", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert re.search(rf"{STATE}.* 3 ", said)
    assert run("rx90 bag", ["compare", str(tmp_path / "bag"), str(tmp_path / "bag")]) == 0


@pytest.mark.ros
def test_a_type_that_is_not_there_leaves_no_bag(tmp_path: Path, node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal comes once the topic is found: by then the bag's folder is there; it does not stay."""
    from rx90_common.bags.recorder.recording import record as record_here

    node.create_publisher(String, "note", 1)
    monkeypatch.delattr("std_msgs.msg.String")
    with pytest.raises(BagError, match="/note has type std_msgs/msg/String, which the std_"):
        record_here(["note"], [], lambda: BagWriter(tmp_path / "new" / "bag"), StopRequest())
    assert not (tmp_path / "new" / "bag").exists()


@pytest.mark.usefixtures("needs_tf")
@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/CameraInfo", "shape_msgs/msg/SolidPrimitive", "tf2_msgs/msg/TFMessage"]
)
def test_definitions_say_what_the_types_are(name: str) -> None:
    """What the installed package says of a type has the type hash (REP 2016) that Jazzy's own definition has."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    assert message_types.types_with(name, Stores.EMPTY).hash_rihs01(name) == jazzy.hash_rihs01(name)
