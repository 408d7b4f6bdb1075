"""Writing bags from arrays."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from bag_making import STORAGES, series, write_one
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from rx90_common.bags import writing
from rx90_common.bags.batch import series_encoder
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.bags.writing import BagWriter, RawMessage, offered_qos, string_message, write_joint_states
from rx90_common.base.errors import FAILED, REFUSED, BagError, BagWriteError


@pytest.mark.parametrize("storage", STORAGES)
def test_bag_opens_elsewhere(tmp_path: Path, storage: str) -> None:
    """Rosbags finds every message at its stamp, in order, with its values and its quality of service."""
    fast, slow = series(40, topic="/motor_states"), series(10, topic="joint_states", step_ns=4_000_000)
    path = tmp_path / "bag"
    write_joint_states(path, [fast, slow], storage=storage, messages=[string_message("robot_description", "<robot/>")])
    found: list[tuple[int, str]] = []
    with AnyReader([path]) as reader:
        for connection, log_ns, data in reader.messages():
            found.append((log_ns, connection.topic))
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/robot_description":
                assert message.data == "<robot/>"
                continue
            source = fast if connection.topic == fast.topic else slow
            row = int(np.flatnonzero(source.stamp_ns == log_ns)[0])
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == log_ns
            assert tuple(message.name) == source.names
            for field, values in source.fields.items():
                np.testing.assert_array_equal(getattr(message, field), values[row])
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}  # type: ignore[union-attr]
    expected = [(t, "/motor_states") for t in range(0, 40_000_000, 1_000_000)]
    expected += [(t, "/joint_states") for t in range(0, 40_000_000, 4_000_000)]
    expected.append((0, "/robot_description"))
    order = ["/motor_states", "/joint_states", "/robot_description"]
    assert found == sorted(expected, key=lambda entry: (entry[0], order.index(entry[1])))
    assert all(q.reliability is QosReliability.RELIABLE for q in qos.values())
    assert [qos[t].durability for t in order] == [QosDurability.VOLATILE] * 2 + [QosDurability.TRANSIENT_LOCAL]


@pytest.mark.parametrize("storage", STORAGES)
def test_equal_calls_give_equal_files(tmp_path: Path, storage: str) -> None:
    """Writing the same series twice gives the same bytes in every file."""
    contents = []
    for folder in ("first", "second"):
        write_joint_states(tmp_path / folder / "bag", [series(3000)], storage=storage)
        contents.append({p.name: p.read_bytes() for p in (tmp_path / folder / "bag").iterdir()})
    assert contents[0] == contents[1]


def test_messages_are_those_of_rclpy(tmp_path: Path) -> None:
    """For rclpy a written message is the same JointState, and its own bytes differ in the padding alone."""
    from sensor_msgs.msg import JointState

    written = series(2)
    write_joint_states(tmp_path / "bag", [written])
    with AnyReader([tmp_path / "bag"]) as reader:
        raw = [data for _, _, data in reader.messages()][1]
    message = deserialize_message(raw, JointState)
    expected = JointState(name=list(written.names))
    expected.header.stamp.nanosec = 1_000_000
    for field, values in written.fields.items():
        setattr(expected, field, values[1].tolist())
    assert message == expected
    theirs = np.frombuffer(serialize_message(expected)[: len(raw)], dtype=np.uint8)
    ours = np.frombuffer(raw, dtype=np.uint8)
    assert len(theirs) == len(ours)
    different = np.flatnonzero(theirs != ours)
    assert not ours[different].any()  # padding: zero here, anything there
    assert len(different) <= 3 * (2 + len(written.names)) + 4 * 3


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """A folder that exists, even an empty one, is refused and stays as it is."""
    path = tmp_path / "bag"
    path.mkdir()
    (path / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match="exists already"):
        BagWriter(path)
    assert [p.name for p in path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda p: BagWriter(p / "x", "csv"), "storage is 'csv'; accepted: mcap, sqlite3"),
        (lambda p: BagWriter(p / "file" / "bag"), "cannot be written"),
        (lambda p: write_joint_states(p / "x", [series(), series()]), "each topic once"),
        (lambda p: BagWriter(p / "x").add_topic("t", "my_msgs/msg/Odd"), "common interfaces"),
    ],
)
def test_mistakes_are_refused(tmp_path: Path, call: Any, complaint: str) -> None:
    """A wrong storage, place, topic list or type is refused with what is accepted."""
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match=complaint) as refusal:
        call(tmp_path)
    assert refusal.value.exit_code == REFUSED


def test_a_full_disk_is_no_mistake_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk without room for a new bag's folder is a failure, not a refusal."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(BagWriteError, match="No space left on device"):
        BagWriter(tmp_path / "bag")


class _Usage(NamedTuple):
    total: int
    used: int
    free: int


@pytest.mark.parametrize("storage", STORAGES)
def test_bag_is_whole_when_the_disk_is_nearly_full(
    tmp_path: Path, storage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Writing stops with a clear line while index and metadata still fit; what was written can be read.

    Of a bag that gets its name at the end nothing stays.
    """
    monkeypatch.setattr(shutil, "disk_usage", lambda _: _Usage(1 << 40, 1 << 40, 5 << 20))
    monkeypatch.setattr(writing, "_BYTES_PER_SPACE_CHECK", 100_000)
    written = series(3000)
    with pytest.raises(BagWriteError, match=r"nearly full \(5 MiB left; accepted: 64 MiB or more\)$") as failure:
        write_joint_states(tmp_path / "new" / "bag", [written], storage=storage)
    assert failure.value.exit_code == FAILED
    assert list(tmp_path.iterdir()) == []
    bag = BagWriter(tmp_path / "bag", storage)
    numbers = np.full(3000, bag.add_topic("joint_states", JOINT_STATE, [offered_qos()]).id)
    messages = series_encoder(written)[1](np.arange(3000))
    with pytest.raises(BagWriteError, match=r"64 MiB or more\); what was written is whole"):
        bag.write_many(numbers, written.stamp_ns, messages)
    bag.close()
    read = read_joint_states(tmp_path / "bag", "joint_states")
    assert 0 < len(read.stamp_ns) < 3000
    np.testing.assert_array_equal(read.stamp_ns, written.stamp_ns[: len(read.stamp_ns)])


def test_a_bag_has_its_name_when_it_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a bag is written nothing has its name, so that a kill leaves none; an interrupt leaves nothing."""
    path, seen = tmp_path / "new" / "bag", []
    whole = BagWriter.write_many

    def watched(self: BagWriter, *arguments: Any) -> None:
        seen.append(path.exists())
        whole(self, *arguments)
        seen.append(path.exists())

    monkeypatch.setattr(BagWriter, "write_many", watched)
    write_joint_states(path, [series(10)])
    assert seen == [False, False]
    assert [p.name for p in path.parent.iterdir()] == ["bag"]
    assert sorted(p.name for p in path.iterdir()) == ["bag.mcap", "metadata.yaml"]
    assert len(read_joint_states(path, "joint_states").stamp_ns) == 10

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BagWriter, "write_many", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_joint_states(tmp_path / "other", [series(10)])
    assert [p.name for p in tmp_path.iterdir()] == ["new"]


def test_a_name_that_is_taken_meanwhile_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that another process makes while a bag is written stays as it is, and the bag is refused in one line."""
    path, whole = tmp_path / "bag", BagWriter.write_many

    def overtaken(self: BagWriter, *arguments: Any) -> None:
        path.mkdir()
        (path / "theirs").touch()
        whole(self, *arguments)

    monkeypatch.setattr(BagWriter, "write_many", overtaken)
    with pytest.raises(BagError, match=r"bag exists already, not overwriting"):
        write_joint_states(path, [series(10)])
    assert [str(p.relative_to(tmp_path)) for p in sorted(tmp_path.rglob("*"))] == ["bag", "bag/theirs"]


@pytest.mark.parametrize("storage", STORAGES)
def test_a_checkpoint_outlives_the_process(tmp_path: Path, storage: str) -> None:
    """What was written a second of log time ago is on the disk before the bag is closed."""
    bag = BagWriter(tmp_path / "bag", storage)
    connection = bag.add_topic("text", "std_msgs/msg/String", [offered_qos()])
    message = string_message("text", "marked content")
    write_one(bag, connection, 0, message.cdr)
    (file,) = (p for p in (tmp_path / "bag").iterdir() if p.suffix in {".mcap", ".db3"})
    assert b"marked content" not in file.read_bytes()
    write_one(bag, connection, 1_000_000_000, message.cdr)
    assert file.read_bytes().count(b"marked content") == 2
    bag.close()


def test_other_messages_keep_their_time(tmp_path: Path) -> None:
    """A message of another type stands in the bag at its own log time."""
    text = string_message("note", "x")
    late = RawMessage("note", text.msgtype, 5_500_000, text.cdr)
    write_joint_states(tmp_path / "bag", [series(10)], messages=[late])
    with AnyReader([tmp_path / "bag"]) as reader:
        times = [(c.topic, t) for c, t, _ in reader.messages()]
    assert times[5:8] == [
        ("/joint_states", 5_000_000),
        ("/note", 5_500_000),
        ("/joint_states", 6_000_000),
    ]
