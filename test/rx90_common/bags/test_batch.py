"""Batches of messages, and what writes them."""

from __future__ import annotations

from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from bag_making import STORAGES
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from rx90_common.bags.batch import MessageBatch
from rx90_common.bags.writing import BagWriter, typestore
from rx90_common.base.stamps import cdr_stamp_ns


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
        """Write the summary; the footer says where it begins, and has its checksum."""
        super().close(version, metadata)
        content = bytearray(self.path.read_bytes())
        summary = int.from_bytes(content[-28:-20], "little")
        content[-12:-8] = crc32(content[summary:-12]).to_bytes(4, "little")
        self.path.write_bytes(content)


class Theirs(Writer):
    """rosbags' writer, message by message; checksums are put in afterwards."""

    STORAGE_PLUGINS = Writer.STORAGE_PLUGINS | {StoragePlugin.MCAP: ChecksummedWriter}


CHANNELS = (("/a", "std_msgs/msg/String"), ("/b", "sensor_msgs/msg/JointState"), ("/c", "std_msgs/msg/String"))


@settings(max_examples=50)
@given(st.lists(st.lists(st.binary(max_size=20))), st.data())
def test_messages_are_kept_as_they_are(groups: list[list[bytes]], data: st.DataObject) -> None:
    """Joined and taken in any order, messages of any length, also 0, stay whole and keep their stamps."""
    flat = [message for group in groups for message in group]
    batch = MessageBatch.join([MessageBatch.of(group) for group in groups])
    assert (list(batch), len(batch), batch.total) == (flat, len(flat), sum(map(len, flat)))
    rows = data.draw(st.lists(st.integers(0, len(flat) - 1))) if flat else []
    assert list(batch.take(np.array(rows, dtype=np.intp))) == [flat[row] for row in rows]
    assert list(batch.take(slice(1, 3))) == flat[1:3]
    # cdr_stamp_ns looks at the last bit of the second byte alone, too, and leaves negative times to its caller.
    assert batch.stamps_ns().tolist() == [max(0, cdr_stamp_ns(message)) for message in flat]


@given(
    st.lists(st.sampled_from([b"", b"a" * 12, b"b" * 12, b"a" * 13, b"a" * 12 + b"b"])), st.sampled_from([b"", b"x"])
)
def test_repetitions_are_found(messages: list[bytes], before: bytes) -> None:
    """A message counts as a repetition where all its bytes are those of the one before it."""
    expected = [one == other for one, other in zip(messages, [before, *messages], strict=False)]
    assert MessageBatch.of(messages).repeats(before).tolist() == expected


@pytest.mark.parametrize("storage", STORAGES)
def test_files_are_those_of_rosbags(tmp_path: Path, storage: str) -> None:
    """Batches of any size, also across chunks and with messages larger than one, give the bytes that rosbags gives."""
    random = np.random.default_rng(3)
    sizes = np.concatenate([random.integers(0, 3000, 1500), [3 << 20, 0, 1 << 20], random.integers(0, 50, 200)])
    messages = [random.bytes(int(size)) for size in sizes]
    log_ns = random.integers(0, 10**9, len(messages))  # in less than a second: without a checkpoint
    channel = random.integers(1, 1 + len(CHANNELS), len(messages))
    with Theirs(tmp_path / "theirs" / "bag", version=9, storage_plugin=StoragePlugin[storage.upper()]) as theirs:
        connections = [theirs.add_connection(*each, typestore=typestore()) for each in CHANNELS]
        for number, time, message in zip(channel, log_ns.tolist(), messages, strict=True):
            theirs.write(connections[number - 1], time, message)
    with BagWriter(tmp_path / "ours" / "bag", storage) as ours:
        for each in CHANNELS:
            ours.add_topic(*each)
        for rows in np.split(np.arange(len(messages)), [1, 2, 700, 1501]):
            ours.write_many(channel[rows], log_ns[rows], MessageBatch.of([messages[row] for row in rows]))
    for file in (tmp_path / "theirs" / "bag").iterdir():
        assert (tmp_path / "ours" / "bag" / file.name).read_bytes() == file.read_bytes()
