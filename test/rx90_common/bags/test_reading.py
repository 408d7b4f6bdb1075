"""Joint states of any bag as arrays, and the summary of a bag."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from bag_making import NAMES, ROS1, as_sqlite, joint_state, series, write_ros1, write_ros2
from hypothesis import given, settings
from hypothesis import strategies as st

from rx90_common.bags.reading import JointSeries, read_joint_bag, read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.errors import BagError

FLOATS = st.floats(width=64)  # also NaN, infinities, -0.0
NAME = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=9)
JOINT_NAMES = st.lists(NAME, min_size=1, max_size=7, unique=True)


@st.composite
def recordings(draw: Any) -> tuple[list[str], tuple[bool, bool, bool], list[dict[str, Any]]]:
    names = draw(JOINT_NAMES)
    present = draw(st.tuples(st.booleans(), st.booleans(), st.booleans()))
    messages = []
    for _ in range(draw(st.integers(1, 6))):
        order = draw(st.permutations(range(len(names)))) if draw(st.booleans()) else range(len(names))
        values = draw(st.lists(FLOATS, min_size=3 * len(names), max_size=3 * len(names)))
        stamp = draw(st.integers(0, (1 << 31) * 1_000_000_000 - 1))
        messages.append({"order": list(order), "values": np.array(values).reshape(3, -1), "stamp": stamp,
                         "frame_id": draw(st.sampled_from(["", "base_link"]))})  # fmt: skip
    return names, present, messages


@settings(max_examples=30)
@given(recordings(), st.booleans())
def test_arrays_are_what_was_written(recording: Any, ros1: bool) -> None:
    """Whatever the names, their order, the arrays present and the numbers, reading gives the written bits."""
    names, present, messages = recording
    store = {"store": ROS1} if ros1 else {}
    written = []
    for i, m in enumerate(messages):
        arrays = (m["values"][f][m["order"]] if present[f] else () for f in range(3))
        order = [names[k] for k in m["order"]]
        written.append(("/joint_states", i, joint_state(m["stamp"], order, *arrays, frame_id=m["frame_id"], **store)))
    with TemporaryDirectory() as folder:
        path = Path(folder) / ("bag.bag" if ros1 else "bag")
        (write_ros1 if ros1 else write_ros2)(path, written)
        read = read_joint_states(path, "joint_states", names)
    assert read.names == tuple(names)
    assert read.stamp_ns.tolist() == [m["stamp"] for m in messages]
    for f, values in enumerate((read.position, read.velocity, read.effort)):
        if not present[f]:
            assert values is None
        else:
            assert values.tobytes() == np.array([m["values"][f] for m in messages]).tobytes()


def test_padding_and_slack_do_not_matter(tmp_path: Path) -> None:
    """Uninitialised padding and unused bytes at the end, as serialisers leave them, change no value."""
    from bag_making import JOINT_STATE, ROS2

    messages: list[tuple[str, int, Any]] = []
    for i in range(50):
        raw = bytearray(ROS2.serialize_cdr(joint_state(i, ["ab", "c"], [i, 2.0]), JOINT_STATE))
        raw[17:20] = bytes([i, 255, i])  # behind the empty frame_id
        messages.append(("/joint_states", i, bytes(raw) + bytes([i] * (i % 4))))
    read = read_joint_states(write_ros2(tmp_path / "bag", messages), "joint_states")
    np.testing.assert_array_equal(read.position, [[i, 2.0] for i in range(50)])


def test_sets_of_joints_are_kept_apart(tmp_path: Path) -> None:
    """Two publishers of different joints on one topic give two series; names pick one, others are refused."""
    sets = (["joint_1", "joint_2"], ["gripper"])
    messages = [("/joint_states", i, joint_state(i, sets[i % 2], [i] * len(sets[i % 2]))) for i in range(10)]
    path = write_ros2(tmp_path / "bag", messages)
    assert [list(s.names) for s in read_joint_bag(path).series["/joint_states"]] == list(sets)
    picked = read_joint_states(path, "joint_states", ["joint_2"])
    assert picked.position[:, 0].tolist() == [0, 2, 4, 6, 8]
    for topic, names, complaint in (
        ("joint_states", None, "several sets of joints"),
        ("joint_states", ["elbow"], "no joint 'elbow'"),
        ("motor_states", None, "no topic /motor_states; JointState topics: /joint_states"),
    ):
        with pytest.raises(BagError, match=complaint):
            read_joint_states(path, topic, names)


@pytest.mark.parametrize(
    ("second", "complaint"),
    [
        (joint_state(7, ["a", "b"], [1.0, 2.0], [1.0]), "1 number in velocity for 2 joints"),
        (joint_state(7, ["a", "a"], [1.0, 2.0]), "each once"),
        (joint_state(7, ["a", "b"], [1.0, 2.0], [1.0, 2.0]), "carries position in some messages and position, vel"),
        (b"\x00\x01\x00\x00\x00\x00", "is no sensor_msgs/msg/JointState"),
    ],
)
def test_impossible_messages_are_refused(tmp_path: Path, second: Any, complaint: str) -> None:
    """A message that is no proper JointState is refused with bag, topic and what is wrong."""
    path = write_ros2(tmp_path / "bag", [("/x", 0, joint_state(0, ["a", "b"], [1.0, 2.0])), ("/x", 1, second)])
    with pytest.raises(BagError, match=complaint) as caught:
        read_joint_states(path, "x")
    assert str(caught.value).startswith(str(path))
    assert "/x" in str(caught.value)


def test_series_are_checked_and_cut() -> None:
    """A series refuses wrong shapes, types and repeated names; its parts keep rows and columns together."""
    good = series(4)
    picked = good.select(["joint_3", "joint_1"]).take(slice(1, 3))
    np.testing.assert_array_equal(picked.position, good.position[1:3][:, [2, 0]])
    np.testing.assert_allclose(good.time, [0.0, 0.001, 0.002, 0.003])
    for bad in (
        {"position": good.position[:, :2]},
        {"position": good.position.astype(np.float32)},
        {"names": ("a", "a", "b")},
        {"stamp_ns": good.stamp_ns.astype(float)},
    ):
        with pytest.raises(BagError, match="accepted"):
            JointSeries(**({"topic": "/t", "names": NAMES, "stamp_ns": good.stamp_ns} | bad))


@pytest.mark.slow
@pytest.mark.usefixtures("warm")  # whose imports bring no rclpy either: it would not fork
def test_reading_and_writing_need_no_ros() -> None:
    """Reading, writing, comparing and summarising import nothing of rclpy."""
    modules = [f"rx90_common.bags.{name}" for name in ("reading", "writing", "comparison", "summary")]
    modules += ["rx90_emulator.cli.bag"]
    code = "import sys; sys.modules['rclpy'] = None\n" + "".join(f"import {m}\n" for m in modules)
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_counts_rates_and_gaps(tmp_path: Path, kind: str) -> None:
    """Count, rate, first and last stamp, number of gaps and the longest of them are those of the stamps."""
    steady = series(101, step_ns=250_000, topic="/motor_states")
    rows = np.r_[0:10, 11:30, 33:60, 70:101]
    written = tmp_path / "bag"
    write_joint_states(written, [steady, series(101).take(rows)], messages=[string_message("note", "")])
    bag = as_sqlite(written) if kind == "db3" else written
    bag = bag.rename(tmp_path / "50% of a#1?")  # signs with a meaning in the URI by which a database is opened
    summary = summarise(bag)
    assert summary.count == 101 + 87 + 1
    joint, motor, note = summary.topics
    assert (motor.rate, motor.gaps, motor.longest_gap_ns) == (4000.0, 0, 0)
    assert (motor.first_ns, motor.last_ns) == (0, 25_000_000)
    assert (joint.gaps, joint.longest_gap_ns) == (3, 11_000_000)
    assert joint.rate == pytest.approx(860.0)
    assert (note.count, note.rate) == (1, None)


def test_time_that_goes_back(tmp_path: Path) -> None:
    """Stamps that repeat or go back are counted, in ROS 1 bags too."""
    stamps = [0, 10, 20, 20, 30, 5, 15]
    path = write_ros1(
        tmp_path / "bag.bag", [("/x", i, joint_state(s, ["a"], [1.0], store=ROS1)) for i, s in enumerate(stamps)]
    )
    (topic,) = summarise(path).topics
    assert (topic.backward, topic.repeated, topic.first_ns, topic.last_ns) == (1, 1, 0, 30)
