"""Bags of all kinds, opened to be looked at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_making import joint_state, write_ros2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from rx90_common.bags import decoding
from rx90_common.base.errors import BagError, Rx90Error
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.lines.task import load_task
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.loop.line import path_accuracy
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.player import path_error_text
from rx90_emulator.view.recording import Recording, open_recording
from rx90_emulator.view.track import path_error_track

REFERENCE = Path(__file__).resolve().parents[2] / "reference" / "reference_task"
JOINTS = [f"joint_{k}" for k in range(1, 7)]
MOTORS = [f"motor_{k}" for k in range(1, 7)]
STEP = 1_000_000


def opened(path: Path, setup: Setup, **options: object) -> Recording:
    """Return what is shown of a bag of the setup's robot."""
    return open_recording(path, setup.robot, RobotFiles(), MeasuredLayout(**options))  # type: ignore[arg-type]


def positions(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps, ns, and positions of a topic as rosbags alone reads them."""
    stamps, found = [], []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        for connection, _, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            found.append(message.position)
    return np.array(stamps), np.array(found)


def test_a_bag_of_the_suite_is_read_whole(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint angles, set-points and friction are those that rosbags reads, however the messages fall into blocks."""
    monkeypatch.setattr(decoding, "_BLOCK", 37)
    recording = opened(REFERENCE, shipped)
    assert recording.lacking == ()
    assert recording.reference is not None
    assert recording.friction is not None
    for track, topic in ((recording.arm, "/joint_states"), (recording.reference, "/rx90_controller/reference")):
        stamps, values = positions(REFERENCE, topic)
        np.testing.assert_array_equal(track.time_ns, stamps)
        np.testing.assert_array_equal(track.values["position"], values)
    assert recording.friction.names == shipped.friction.names
    assert len(recording.friction.time_ns) == len(recording.arm.time_ns)


def test_the_path_error_of_a_bag_is_that_of_the_run(shipped: Setup) -> None:
    """The page's largest path error of the reference line is the one that `rx90_run` gives for the same states."""
    recording = opened(REFERENCE, shipped)
    found = path_error_track(recording.arm, recording.reference, shipped.robot.chain)
    assert found is not None
    times = recording.arm.time_ns * 1e-9
    run = path_accuracy(shipped.robot, load_task(), times, recording.arm.values["position"])
    error = found.values["position"][:, 0]
    assert np.nanmax(error) == pytest.approx(run.worst, rel=1e-6)
    said = f"largest path error {1e3 * run.worst:.3f} mm, at {times[np.nanargmax(error)]:.3f} s"
    assert said in path_error_text("reference", found, 0)


def test_joint_states_of_others(tmp_path: Path, shipped: Setup) -> None:
    """Joints are taken by name, whatever their order, namespace and company, and messages of a gripper are left out."""
    random = np.random.default_rng(2)
    values = random.normal(size=(20, 6))
    order = [*JOINTS[::-1], "rail"]
    messages = []
    for k in range(20):
        messages.append(("/cell/joint_states", k * STEP, joint_state(k * STEP, order, [*values[k, ::-1], 7.0])))
        messages.append(("/cell/joint_states", k * STEP, joint_state(k * STEP, ["finger"], [0.1])))
        messages.append(("/cell/sampled/joint_states", k * STEP, joint_state(k * STEP, JOINTS, [0.0] * 6)))
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped)
    np.testing.assert_array_equal(recording.arm.values["position"], values)
    assert recording.lacking == ("velocity", "drive torque", "friction", "set-points")


def test_motor_states_alone(tmp_path: Path, shipped: Setup) -> None:
    """Where a bag has the motors' states alone, joints are seen through the gears, motor 6 with joints 5 and 6."""
    random = np.random.default_rng(3)
    joints, torque, gear = random.normal(size=(5, 6)), random.normal(size=(5, 6)), shipped.drives.gear
    motors = gear * np.column_stack([joints[:, :5], joints[:, 4] + joints[:, 5]])
    messages = [
        ("/motor_states", k * STEP, joint_state(k * STEP, MOTORS, motors[k], motors[k], torque[k])) for k in range(5)
    ]
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped, zero=[0.0, 0.1, 0, 0, 0, 0])
    zero = np.array([0.0, 0.1, 0, 0, 0, 0])
    np.testing.assert_allclose(recording.arm.values["position"], joints - zero, atol=1e-13)
    np.testing.assert_allclose(recording.arm.values["velocity"], joints, atol=1e-13)
    # Power is the same on both sides.
    power = np.sum(motors * torque, axis=1)
    np.testing.assert_allclose(np.sum(joints * recording.arm.values["effort"], axis=1), power, rtol=1e-12)


def _states(topic: str, names: list[str], stamps: range, value: float = 0.1) -> list[tuple[str, int, object]]:
    return [(topic, k, joint_state(stamp, names, [value] * len(names))) for k, stamp in enumerate(stamps)]


@pytest.mark.parametrize(
    ("messages", "options", "said"),
    [
        (_states("/joint_states", ["a", "b", "c", "d", "e", "f"], range(5)), {}, "is of a, b, c"),
        (_states("/joint_states", JOINTS[:5], range(5)), {}, "--names"),
        (_states("/joint_states", [f"a{k}" for k in range(7)], range(5)), {}, "every arm here has 6 joints"),
        (_states("/a/joint_states", JOINTS, range(3)) + _states("/b/joint_states", JOINTS, range(3)), {}, "--topic"),
        (_states("/tool", JOINTS, range(3)), {}, "neither joint_states nor motor_states; JointState topics"),
        (_states("/joint_states", JOINTS, range(3)), {"topic": "nothing"}, "no messages in /nothing"),
        (_states("/joint_states", JOINTS, range(0, 1)) * 3, {}, "--record-time"),
        (_states("/joint_states", JOINTS, range(3)), {"gear": [1.0]}, "--gear: 1 values; accepted: 6"),
        (_states("/joint_states", JOINTS, range(3)), {"coupling": [1.0] * 36}, "--coupling without --gear"),
        ([("/joint_states", k, joint_state(k, JOINTS, (), [0.0] * 6)) for k in range(3)], {}, "carries no positions"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    tmp_path: Path, shipped: Setup, messages: list[tuple[str, int, object]], options: dict[str, object], said: str
) -> None:
    """Joints of other names, several arms, no times, options of another size: one line with what is accepted."""
    bag = write_ros2(tmp_path / "bag", messages)
    with pytest.raises(Rx90Error) as caught:
        opened(bag, shipped, **options)
    text = str(caught.value)
    assert said in text
    assert "\n" not in text
    assert "accepted" in text
    assert caught.value.exit_code == 2


def test_a_bag_of_another_robot_is_refused(tx40: Setup) -> None:
    """A bag that says of which robot it is is not shown with another's arm."""
    with pytest.raises(BagError, match=r"recorded of the robot 'rx90b'.*--robot"):
        open_recording(REFERENCE, tx40.robot, RobotFiles.named("tx40"), MeasuredLayout())


def test_what_is_odd_in_a_bag_is_told(tmp_path: Path, shipped: Setup) -> None:
    """Joints beyond their range, as another robot's, positions that are no numbers, and resets each make a note."""
    good = [(k, [0.1] * 6) for k in range(5)]
    odd = [(k, [0.1, 0.1, 3.0 * k, 0.1, 0.1, 0.1]) for k in range(4)]
    messages = [
        ("/joint_states", number, joint_state(k * STEP, JOINTS, values))
        for number, (k, values) in enumerate([*good, (5, [np.nan] * 6), *odd])
    ]
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped)
    assert len(recording.arm.time_ns) == 4
    said = " ".join(recording.notes)
    assert "1 messages of /joint_states without finite positions" in said
    assert "goes back 1 times" in said
    assert "joint_3 goes from 0 to 9 rad, which rx90b cannot" in said


def test_times_of_recording_take_the_place_of_stamps(tmp_path: Path, shipped: Setup) -> None:
    """Where stamps are all 0, the times of recording can be taken."""
    messages = [("/joint_states", 5 * k * STEP, joint_state(0, JOINTS, [0.1 * k] * 6)) for k in range(4)]
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped, record_time=True)
    np.testing.assert_array_equal(recording.arm.time_ns, 5 * STEP * np.arange(4))
