"""Types that are none of the common interfaces, in bags: recorded with their definitions, and read elsewhere."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from bag_making import STORAGES, write_one
from processes import TIMEOUT, Processes, wait_until
from ros_client import own_node
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_typestore

from rx90_common.bags.recorder import stream
from rx90_common.bags.writing import BagWriter, offered_qos
from rx90_common.base.errors import BagError
from rx90_common.process.interrupts import StopRequest
from rx90_emulator.cli.frame import run

STATE = "control_msgs/msg/JointTrajectoryControllerState"
# Of the real package's definition (control_msgs 5.8.0), by Jazzy's rosidl_generator_type_description.
STATE_HASH = "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
TOPICS = {"/joint_states": 3, "/tf_static": 1, "/tf": 4, "/rx90_controller/controller_state": 3}


@pytest.mark.ros
@pytest.mark.usefixtures("needs_action", "needs_tf")
def test_controller_state_and_transforms_are_recorded(
    tmp_path: Path, ros_domain: int, processes: Processes, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rosbags reads them with what the bag says of their types alone, each at its own stamp; so do info and compare.

    Latched transforms that were sent before the recorder came are there, and latched again.
    """
    from control_msgs.msg import JointTrajectoryControllerState
    from geometry_msgs.msg import TransformStamped
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState
    from tf2_msgs.msg import TFMessage

    with own_node("nodes", ros_domain) as node:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        fixed, moving = (
            node.create_publisher(TFMessage, "tf_static", latched),
            node.create_publisher(TFMessage, "tf", 9),
        )
        joints = node.create_publisher(JointState, "joint_states", 9)
        states = node.create_publisher(JointTrajectoryControllerState, "rx90_controller/controller_state", 9)
        fixed.publish(TFMessage(transforms=[TransformStamped(child_frame_id="tool0")]))
        recorder = processes.start("rx90_bag", "record", "-o", tmp_path / "bag", *TOPICS)
        recorder.wait_for("ready: all 4 topics")
        publishers = (fixed, moving, joints, states)
        # A publisher may hear of a listener later than the listener of it.
        wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers), "the recorder")
        for nanosec in (10, 20, 30):
            clock, state = (
                JointState(name=["a"], position=[0.5]),
                JointTrajectoryControllerState(joint_names=["a", "b"]),
            )
            clock.header.stamp.nanosec = state.header.stamp.nanosec = nanosec * 1_000_000
            state.reference.positions, state.speed_scaling_factor = [0.25, nanosec * 1.0], 0.75
            one = TransformStamped(child_frame_id="link_1", header=state.header)
            for publisher, message in ((states, state), (moving, TFMessage(transforms=[one, one])), (joints, clock)):
                publisher.publish(message)
        moving.publish(TFMessage())
        assert all(publisher.wait_for_all_acked(Duration(seconds=TIMEOUT)) for publisher in publishers)
        recorder.signal(signal.SIGINT)
        assert recorder.wait() == 0
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, log_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((log_ns, reader.deserialize(data, connection.msgtype)))
        kinds = {connection.topic: connection for connection in reader.connections}
    assert {topic: len(messages) for topic, messages in found.items()} == TOPICS
    for topic, stamped in (("/rx90_controller/controller_state", 3), ("/tf", 3), ("/joint_states", 3)):
        assert [log_ns for log_ns, _ in found[topic][:stamped]] == [10_000_000, 20_000_000, 30_000_000]
    state = found["/rx90_controller/controller_state"][1][1]
    assert (state.joint_names, state.speed_scaling_factor) == (["a", "b"], 0.75)
    assert state.reference.positions.tolist() == [0.25, 20.0]
    assert [one.child_frame_id for _, message in found["/tf"] for one in message.transforms] == ["link_1"] * 6
    assert found["/tf_static"][0][1].transforms[0].child_frame_id == "tool0"
    durability = {topic: kind.ext.offered_qos_profiles[0].durability for topic, kind in kinds.items()}
    assert [topic for topic, kind in durability.items() if kind is QosDurability.TRANSIENT_LOCAL] == ["/tf_static"]
    assert kinds["/rx90_controller/controller_state"].digest == STATE_HASH

    assert run("rx90_bag", ["info", str(tmp_path / "bag")]) == 0
    assert re.search(rf"{STATE}.* 3 ", capsys.readouterr().out)
    assert run("rx90_bag", ["compare", str(tmp_path / "bag"), str(tmp_path / "bag")]) == 0


@pytest.mark.parametrize("storage", STORAGES)
def test_a_definition_goes_into_its_bag_alone(tmp_path: Path, storage: str) -> None:
    """A type with arrays of every kind is read back; another bag without its definition still refuses the type."""
    text = (
        "float64[2] pair\nstring<=3[] words\nint8[<=4] few\nmy_msgs/Inner[] inner\n"
        + "=" * 80
        + "\nMSG: my_msgs/Inner\nbool flag\n"
    )
    odd = "my_msgs/msg/Odd"
    cdr = bytes(4 + 16) + (0).to_bytes(4, "little") * 2 + (1).to_bytes(4, "little") + b"\x01"
    with BagWriter(tmp_path / "bag", storage) as bag:
        write_one(bag, bag.add_topic("odd", odd, [offered_qos()], text), 5, b"\x00\x01\x00\x00" + cdr[4:])
    with AnyReader([tmp_path / "bag"]) as reader:
        ((connection, log_ns, data),) = reader.messages()
        message: Any = reader.deserialize(data, connection.msgtype)
    assert (log_ns, message.pair.tolist(), message.words, message.inner[0].flag) == (5, [0.0, 0.0], [], True)
    with BagWriter(tmp_path / "other", storage) as bag, pytest.raises(BagError, match="my_msgs/msg/Odd"):
        bag.add_topic("odd", odd)


@pytest.mark.ros
def test_a_type_that_is_not_there_leaves_no_bag(
    tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The refusal comes once the topic is found: by then the folder and those above it are there; none stays."""
    from std_msgs.msg import String

    from rx90_common.bags.recorder.recording import Recorder, StatusLine

    monkeypatch.delattr("std_msgs.msg.String")
    with own_node("node", ros_domain) as node, StatusLine() as status:
        publisher = node.create_publisher(String, "note", 1)
        with pytest.raises(BagError, match="/note has type std_msgs/msg/String, which the std_msgs"):
            Recorder(["note"], [], status).run(lambda: BagWriter(tmp_path / "new" / "bag"), StopRequest())
        publisher.destroy()
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("storage", STORAGES)
def test_only_an_error_before_the_first_message_leaves_no_bag(tmp_path: Path, storage: str) -> None:
    """What was written stays, and so does an empty bag that ends as it should; what else lies beside it stays, too."""
    (tmp_path / "mine").write_text("")
    with BagWriter(tmp_path / "empty", storage):
        pass

    def refused(count: int) -> None:
        with BagWriter(tmp_path / f"bag_{count}", storage) as bag:
            topic = bag.add_topic("a", "std_msgs/msg/Empty")
            for _ in range(count):
                write_one(bag, topic, 5, bytes(4))
            raise BagError("refused")

    for count in (0, 1):
        with pytest.raises(BagError, match="refused"):
            refused(count)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["bag_1", "empty", "mine"]
    with AnyReader([tmp_path / "bag_1"]) as reader:
        assert reader.message_count == 1


@pytest.mark.usefixtures("needs_tf")
@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/CameraInfo",
        "shape_msgs/msg/SolidPrimitive",
        "rcl_interfaces/msg/ParameterEvent",
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "tf2_msgs/msg/TFMessage",
    ],
)
def test_definitions_say_what_the_types_are(name: str) -> None:
    """The text of a class has the type hash (REP 2016) that Jazzy's own definition has."""
    from rosbags.typesys import get_types_from_msg

    text = stream.definition(stream.message_class("t", name), ())
    own, jazzy = get_typestore(Stores.EMPTY), get_typestore(Stores.ROS2_JAZZY)
    own.register(get_types_from_msg(text, name))
    assert own.hash_rihs01(name) == jazzy.hash_rihs01(name)


@pytest.mark.parametrize(
    ("msgtype", "words"),
    [
        (STATE, "needs control_msgs, which is not installed; accepted: make action, in the project's folder"),
        ("tf2_msgs/msg/TFMessage", "needs tf2_msgs, which is not installed; accepted: make action"),
        ("std_msgs/msg/Strong", "which the std_msgs that is installed does not have"),
    ],
)
def test_a_type_that_is_not_there_is_one_line(msgtype: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names topic and type, and says how to get it."""
    package = msgtype.partition("/")[0]
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    if package != "std_msgs":
        monkeypatch.setattr(sys, "path", [])
        for module in [module for module in sys.modules if module.partition(".")[0] == package]:
            monkeypatch.delitem(sys.modules, module)
    with pytest.raises(BagError) as refusal:
        stream.message_class("/t", msgtype)
    assert str(refusal.value).startswith(f"/t has type {msgtype}")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.ros
def test_wall_clock_stamps_do_not_stretch_a_bag(
    tmp_path: Path, ros_domain: int, processes: Processes, capsys: pytest.CaptureFixture[str]
) -> None:
    """Diagnostics beside simulated states are dated when they came, and that is said; other readers find the same."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.duration import Duration
    from sensor_msgs.msg import JointState

    with own_node("nodes", ros_domain) as node:
        joints = node.create_publisher(JointState, "joint_states", 9)
        diagnostics = node.create_publisher(DiagnosticArray, "diagnostics", 9)
        recorder = processes.start("rx90_bag", "record", "-o", tmp_path / "bag", "diagnostics", "joint_states")
        recorder.wait_for("ready: all 2 topics")
        wait_until(lambda: joints.get_subscription_count() + diagnostics.get_subscription_count() == 2, "the recorder")
        for second in range(1, 4):
            states, report = JointState(name=["a"], position=[0.5]), DiagnosticArray()
            states.header.stamp.sec, report.header.stamp.sec = second, 1_700_000_000 + second
            for publisher, message in ((diagnostics, report), (joints, states)):
                publisher.publish(message)
        assert all(publisher.wait_for_all_acked(Duration(seconds=TIMEOUT)) for publisher in (diagnostics, joints))
        recorder.signal(signal.SIGINT)
        assert recorder.wait() == 0
    assert "/diagnostics: 3 messages have stamps of another clock; they are dated by when they came" in recorder.output
    with AnyReader([tmp_path / "bag"]) as reader:
        assert (reader.start_time, reader.end_time) == (1_000_000_000, 3_000_000_001)
        assert reader.message_count == 6
    assert run("rx90_bag", ["info", str(tmp_path / "bag")]) == 0
    assert re.search(r"/diagnostics .* 3 stamps of another clock; by log time", capsys.readouterr().out)
