"""Bags that are written: what others read of them, byte by byte, names, and what stays when writing fails."""

import errno
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from bag_making import series
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.bags.writing import (
    BagWriter,
    SingleMessage,
    named_at_the_end,
    offered_qos,
    string_message,
    write_joint_states,
)
from rx90_common.base.errors import FAILED, REFUSED, BagError, BagWriteError
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.message_types import typestore


class ChecksummedWriter(McapWriter):
    """rosbags' mcap writer with the checksums that it leaves out, by the layout in mcap's specification."""

    def close_chunk(self) -> None:
        """Write the chunk; its checksum comes after it, behind the record's head, two times and a size."""
        crc, start = crc32(self.chunk.bio.getvalue()), self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + 9 + 24)
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        super().close(version, metadata)
        content = bytearray(self.path.read_bytes())
        summary = int.from_bytes(content[-28:-20], "little")
        content[-12:-8] = crc32(content[summary:-12]).to_bytes(4, "little")
        self.path.write_bytes(content)


class Theirs(Writer):
    STORAGE_PLUGINS = Writer.STORAGE_PLUGINS | {StoragePlugin.MCAP: ChecksummedWriter}


CHANNELS = (("/a", "std_msgs/msg/String"), ("/b", JOINT_STATE), ("/c", "std_msgs/msg/String"))


def test_files_are_those_of_rosbags(tmp_path: Path) -> None:
    """Batches of any size, also across chunks and with messages larger than one, give the bytes that rosbags gives."""
    random = np.random.default_rng(3)
    sizes = np.concatenate([random.integers(0, 3000, 1500), [3 << 20, 0, 1 << 20], random.integers(0, 50, 200)])
    messages = [random.bytes(int(size)) for size in sizes]
    log_ns = random.integers(0, 10**9, len(messages))
    channel = random.integers(1, 1 + len(CHANNELS), len(messages))
    with Theirs(tmp_path / "theirs" / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as theirs:
        connections = [
            theirs.add_connection(*each, typestore=typestore(), offered_qos_profiles=[offered_qos()])
            for each in CHANNELS
        ]
        for number, time, message in zip(channel, log_ns.tolist(), messages, strict=True):
            theirs.write(connections[number - 1], time, message)
    with BagWriter(tmp_path / "ours" / "bag") as ours:
        for each in CHANNELS:
            ours.add_topic(*each, offered_qos())
        for rows in np.split(np.arange(len(messages)), [1, 2, 700, 1501]):
            ours.write_many(channel[rows], log_ns[rows], [messages[row] for row in rows])
    for file in (tmp_path / "theirs" / "bag").iterdir():
        assert (tmp_path / "ours" / "bag" / file.name).read_bytes() == file.read_bytes()


def test_bag_opens_elsewhere(tmp_path: Path) -> None:
    """Rosbags finds every message at its stamp, in order, with its values and its quality of service."""
    fast, slow = series(40, topic="/motor_states"), series(10, topic="joint_states", step_ns=4_000_000)
    text = string_message("robot_description", "<robot/>")
    note = SingleMessage("note", 5_500_000, text.message)
    write_joint_states(tmp_path / "bag", [fast, slow], messages=[text, note])
    found: list[tuple[int, str]] = []
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection, log_ns, data in reader.messages():
            found.append((log_ns, connection.topic))
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.msgtype != JOINT_STATE:
                assert message.data == "<robot/>"
                continue
            source = fast if connection.topic == fast.topic else slow
            row = int(np.flatnonzero(source.stamp_ns == log_ns)[0])
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == log_ns
            assert tuple(message.name) == source.names
            for field, values in source.fields.items():
                np.testing.assert_array_equal(getattr(message, field), values[row])
        qos = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}  # type: ignore[union-attr]
    order = ["/robot_description", "/note", "/motor_states", "/joint_states"]
    expected = [(t, "/motor_states") for t in range(0, 40_000_000, 1_000_000)]
    expected += [(t, "/joint_states") for t in range(0, 40_000_000, 4_000_000)]
    expected += [(0, "/robot_description"), (5_500_000, "/note")]
    assert found == sorted(expected, key=lambda entry: (entry[0], order.index(entry[1])))
    assert all(q.reliability is QosReliability.RELIABLE for q in qos.values())
    durable = [qos[topic].durability is QosDurability.TRANSIENT_LOCAL for topic in order]
    assert durable == [True, True, False, False]


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda p: BagWriter(p / "file" / "bag"), "cannot be written"),
        (BagWriter, "exists already"),
        (lambda p: write_joint_states(p / "x", [series(), series()]), "each topic once"),
    ],
)
def test_mistakes_are_refused(tmp_path: Path, call: Any, complaint: str) -> None:
    """A wrong storage, place, topic list or type, and a folder that exists, is refused with what is accepted."""
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BagError, match=complaint) as refusal:
        call(tmp_path)
    assert refusal.value.exit_code == REFUSED
    assert (tmp_path / "file").read_text() == "mine"


def test_bag_is_whole_when_the_disk_is_nearly_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writing stops with a clear line while index and metadata still fit; what was written can be read."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=5 << 20))
    written = series(3000)
    bag = BagWriter(tmp_path / "bag")
    numbers = np.full(3000, bag.add_topic("joint_states", JOINT_STATE, offered_qos()))
    messages = [*map(bytes, JointStateCodec(written.names).encode_many(written.stamp_ns, *written.fields.values()))]
    with pytest.raises(BagWriteError, match=r"nearly full \(5 MiB left; accepted: 64 MiB or more\)$") as failure:
        bag.write_many(numbers[:2000], written.stamp_ns[:2000], messages[:2000])
    assert failure.value.exit_code == FAILED
    bag.close()
    read = read_joint_states(tmp_path / "bag", "joint_states")
    np.testing.assert_array_equal(read.stamp_ns, written.stamp_ns[:2000])


def test_no_room_for_a_new_bag_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the disk is full, one line says so."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(BagWriteError, match="No space left on device") as failure:
        BagWriter(tmp_path / "other")
    assert failure.value.exit_code == FAILED


def test_a_bag_has_its_name_when_it_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a bag is written nothing has its name, so that a kill leaves none; an interrupt leaves nothing."""
    path, whole = tmp_path / "new" / "bag", BagWriter.write_many

    def watched(self: BagWriter, *arguments: Any) -> None:
        whole(self, *arguments)
        assert not path.exists()

    monkeypatch.setattr(BagWriter, "write_many", watched)
    write_joint_states(path, [series(10)])
    assert sorted(p.name for p in path.parent.rglob("*")) == ["bag", "bag.mcap", "metadata.yaml"]

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BagWriter, "write_many", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_joint_states(tmp_path / "other", [series(10)])
    assert [p.name for p in tmp_path.iterdir()] == ["new"]


@pytest.mark.parametrize("kind", ["file", "folder", "bag"])
def test_what_came_first_stays(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file or folder that another process makes while one of its name is written stays; ours is one line."""
    output, whole = tmp_path / "export.csv", BagWriter.write_many

    def overtake() -> None:
        if kind == "file":
            output.write_text("of the first")
        else:
            output.mkdir()
            (output / "a").write_text("of the first")

    def overtaken(self: BagWriter, *arguments: Any) -> None:
        overtake()
        whole(self, *arguments)

    def second() -> None:
        if kind == "bag":
            write_joint_states(output, [series(10)])
            return
        with named_at_the_end(output) as folder:
            (folder / output.name).write_text("of the second") if kind == "file" else (folder / output.name).mkdir()
            overtake()

    monkeypatch.setattr(BagWriter, "write_many", overtaken)
    with pytest.raises(BagError, match=r"export\.csv exists already, not overwriting"):
        second()
    assert all(file.is_dir() or file.read_text() == "of the first" for file in tmp_path.rglob("*"))
    assert len(list(tmp_path.rglob("*"))) == (1 if kind == "file" else 2)
