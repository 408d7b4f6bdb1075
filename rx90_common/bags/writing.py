"""Write bags, from the recorder's raw messages or from arrays; needs no ROS.

rosbags' writers make the files; messages are given to them in batches, which gives the same files, byte for byte, and
additional checksums, in a fraction of the time.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from mmap import mmap
from pathlib import Path
from typing import Any, Literal, NamedTuple
from zlib import crc32

import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys.store import Typestore

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.topics import EFFORT_UNIT, JOINT_STATE, STRING, absolute
from rx90_common.base.errors import DISK_ERRORS, BagError, BagWriteError, check_bag_name
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.message_types import typestore
from rx90_common.process.files import hidden_folder

_RESERVE_BYTES = 64 << 20  # kept free on the disk, so that index and metadata still fit
_MESSAGES_AT_ONCE = 10_000  # in memory while arrays are written
_INFINITE = QosTime(9_223_372_036, 854_775_807)
# Of mcap: op codes, and bytes.
_MESSAGE = 0x05
_CHUNK_BYTES = 1 << 20  # a chunk that is larger is closed, as rosbags does
_RECORD_HEAD = 9  # op code and length
_MESSAGE_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
"""Op code, length of what follows, channel, sequence number, log time, time of publication."""
# At the end of a file, before 8 bytes that say what it is: where the summary begins, and its checksum.
_SUMMARY_BEGIN = slice(-28, -20)
_SUMMARY_CRC = slice(-12, -8)


class _McapBatches(McapWriter):
    """rosbags' mcap writer; messages come by `write_many` alone, and chunks and summary get checksums."""

    def write_many(self, channel: Int64Array, log_ns: Int64Array, messages: list[bytes]) -> None:
        """Write messages, in this order, of the channels with these numbers, int64 (n,)."""
        lengths = np.fromiter(map(len, messages), np.int64, len(messages)) + _MESSAGE_HEAD.itemsize
        ends = np.cumsum(lengths)
        begin = 0
        while begin < len(messages):
            room = _CHUNK_BYTES - self.chunk.bio.tell() + ends[begin] - lengths[begin]
            end = int(np.searchsorted(ends, room, side="right")) + 1
            rows = slice(begin, end)
            self._append(channel[rows], log_ns[rows], messages[rows], lengths[rows])
            if self.chunk.bio.tell() > _CHUNK_BYTES:
                self.close_chunk()
            begin = end

    def _append(
        self, channel: Int64Array, log_ns: Int64Array, messages: list[bytes], lengths: Int64Array
    ) -> None:
        """Write messages, whose records have these lengths, into the pending chunk."""
        code = np.full_like(lengths, _MESSAGE)
        columns = [code, lengths - _RECORD_HEAD, channel, np.zeros_like(lengths), log_ns, log_ns]
        heads = np.rec.fromarrays(columns, dtype=_MESSAGE_HEAD)
        places = self.chunk.bio.tell() + np.cumsum(lengths) - lengths
        records = zip(heads.view(f"V{heads.itemsize}").tolist(), messages, strict=True)
        self.chunk.bio.write(b"".join(chain.from_iterable(records)))
        for noted in (self, self.chunk):
            noted.message_start_time = min(int(log_ns.min()), noted.message_start_time)
            noted.message_end_time = max(int(log_ns.max()), noted.message_end_time)
        for number in dict.fromkeys(channel.tolist()):  # in the order of their first messages
            those = channel == number
            self.chunk.msgs[number] += zip(
                log_ns[those].tolist(), places[those].tolist(), strict=True
            )
            self.channel_stats[number] += int(those.sum())

    def close_chunk(self) -> None:
        """Write the pending chunk, and its checksum behind the record's head, two times and a length."""
        crc = crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        self.bio.seek(start + _RECORD_HEAD + 24)
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(0, os.SEEK_END)

    def close(self, version: int, metadata: str) -> None:
        """Write the summary and its checksum, and close the file."""
        super().close(version, metadata)
        with self.path.open("r+b") as stream, mmap(stream.fileno(), 0) as content:
            summary = content[
                int.from_bytes(content[_SUMMARY_BEGIN], "little") : _SUMMARY_CRC.start
            ]
            content[_SUMMARY_CRC] = crc32(summary).to_bytes(4, "little")


def offered_qos(
    reliability: QosReliability = QosReliability.RELIABLE,
    durability: QosDurability = QosDurability.VOLATILE,
) -> Qos:
    """Return a publisher's quality of service as a recorder receives it: its depth is not announced."""
    return Qos(
        history=QosHistory.UNKNOWN,
        depth=0,
        reliability=reliability,
        durability=durability,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )


class BagWriter(Writer):
    """A new rosbag2 folder, open from the start; `close()`, or leaving its context, makes it a valid bag.

    An error within its context before anything was written is a refusal: no folder stays. Equal calls give equal files,
    byte for byte. All calls must come from one thread.

    Args:
        path: folder to make; must not exist.
        named: the name that it will get, for messages.

    Raises:
        BagWriteError: if the disk is full.
    """

    STORAGE_PLUGINS = {StoragePlugin.MCAP: _McapBatches}  # noqa: RUF012 - as in rosbags

    def __init__(self, path: Path, *, named: Path | None = None) -> None:
        self._named = named or path
        check_bag_name(self._named)
        with _failures(self._named):
            super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self.open()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, _kind: object, error: object, _trace: object) -> Literal[False]:
        if error is None:
            self.close()
            return False
        with suppress(BagError):  # the first error is the one to report
            self.close()
        if not any(self.counts.values()):
            shutil.rmtree(self.path, ignore_errors=True)
        return False

    def add_topic(self, topic: str, msgtype: str, qos: Qos, types: Typestore | None = None) -> int:
        """Announce a topic and return its number, as `write_many` wants it.

        Args:
            topic: its name.
            msgtype: name of its type.
            qos: quality of service that its publishers offer.
            types: knows the type; by default the common interfaces.
        """
        types = types or typestore()
        return self.add_connection(
            absolute(topic), msgtype, typestore=types, offered_qos_profiles=[qos]
        ).id

    def write_many(self, number: Int64Array, log_ns: Int64Array, messages: list[bytes]) -> None:
        """Write serialised messages in this order.

        Args:
            number: of the topic of each, int64 (n,).
            log_ns: log times, int64 (n,).
            messages: n messages, at least one.

        Raises:
            BagWriteError: if the disk is full or nearly so.
        """
        storage: Any = self.storage
        with _failures(self._named):
            storage.write_many(number, log_ns, messages)
            free = shutil.disk_usage(self.path).free
        if free < _RESERVE_BYTES:
            room = f"{free >> 20} MiB left; accepted: {_RESERVE_BYTES >> 20} MiB or more"
            when = f"t = {log_ns[-1] / NANOSECONDS:.6f} s"
            raise BagWriteError(
                f"{plain(self._named)}: stopped at {when}, as the disk is nearly full ({room})"
            )

    def close(self) -> None:
        """Write index and metadata. A second call does nothing.

        Raises:
            BagWriteError: if that fails; data written before stay.
        """
        storage: Any = self.storage
        if storage is None:
            return
        self.counts.update(storage.channel_stats)
        self.min_timestamp = storage.message_start_time
        self.max_timestamp = storage.message_end_time
        with _failures(self._named):
            try:
                super().close()
            finally:
                self.abort()


@contextmanager
def _failures(path: Path) -> Iterator[None]:
    """Say in a line why a bag or a table cannot be written."""
    try:
        yield
    except (FileExistsError, WriterError) as error:
        raise BagError(f"{plain(path)} exists already, not overwriting.") from error
    except OSError as error:
        kind = BagWriteError if error.errno in DISK_ERRORS else BagError
        raise kind(f"{plain(path)}: cannot be written ({error.strerror})") from error


class SingleMessage(NamedTuple):
    """A latched message of any type, as rosbags makes it, for `write_joint_states`; log time in ns."""

    topic: str
    log_ns: int
    message: Any

    @property
    def cdr(self) -> bytes:
        """Return the serialised message."""
        return bytes(typestore().serialize_cdr(self.message, self.message.__msgtype__))


def string_message(topic: str, text: str) -> SingleMessage:
    """Return a std_msgs/String, such as robot_description."""
    return SingleMessage(topic, 0, typestore().types[STRING](data=text))


@contextmanager
def named_at_the_end(path: Path) -> Iterator[Path]:
    """Yield a new folder for a file or folder of this name and its companions; then these are moved to their places.

    Raises:
        BagError: if one of them exists by then.
        BagWriteError: if the disk is full.
    """
    with _failures(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with hidden_folder(path) as folder:
            yield folder
            targets = {made: path.parent / made.name for made in folder.iterdir()}
            if any(os.path.lexists(target) for target in targets.values()):
                raise FileExistsError
            for made, target in targets.items():
                made.rename(target)


def write_joint_states(
    path: Path | str, series: Collection[JointSeries], *, messages: Sequence[SingleMessage] = ()
) -> None:
    """Write a bag as if nodes had published these series and the recorder had recorded them.

    It is written beside its place and renamed at the end: an interrupt, a kill or a full disk
    leaves no part of a bag under that name.

    The log time of a series' message is its stamp. The further messages come first in the file: readers go by log time.

    Args:
        path: folder to make; must not exist.
        series: one per topic.
        messages: further messages of the bag.

    Raises:
        BagError: if the bag cannot be made, or two series share a topic.
        BagWriteError: if it cannot be written.
        ExchangeError: for a joint name or a stamp that a message cannot contain.
    """
    path = Path(path)
    topics = [absolute(part.topic) for part in series]
    if len(set(topics)) != len(topics):
        raise BagError(f"{plain(path)}: topics {listed(topics)}; accepted: each topic once")
    with named_at_the_end(path) as folder, BagWriter(folder / path.name, named=path) as bag:
        numbers = [bag.add_topic(topic, JOINT_STATE, offered_qos()) for topic in topics]
        for topic, part in zip(topics, series, strict=True):
            if part.effort_unit:
                bag.set_custom_data(f"{EFFORT_UNIT}{topic}", part.effort_unit)
        latched: dict[str, int] = {}
        for single in messages:
            if single.topic not in latched:
                qos = offered_qos(durability=QosDurability.TRANSIENT_LOCAL)
                latched[single.topic] = bag.add_topic(single.topic, single.message.__msgtype__, qos)
            bag.write_many(
                np.array([latched[single.topic]]), np.array([single.log_ns]), [single.cdr]
            )
        codecs = [JointStateCodec(part.names) for part in series]
        counts = [len(part.stamp_ns) for part in series]
        log_ns = np.concatenate([np.empty(0, dtype=np.int64), *(part.stamp_ns for part in series)])
        source = np.repeat(np.arange(len(series)), counts)
        first_rows = np.cumsum(counts) - counts
        order = np.argsort(log_ns, kind="stable")
        for begin in range(0, len(order), _MESSAGES_AT_ONCE):
            rows = order[begin : begin + _MESSAGES_AT_ONCE]
            block = np.empty(len(rows), dtype=object)
            for k, (codec, whole) in enumerate(zip(codecs, series, strict=True)):
                of_series = source[rows] == k
                part = whole.take(rows[of_series] - first_rows[k])
                data = codec.encode_many(part.stamp_ns, part.position, part.velocity, part.effort)
                block[of_series] = data.view(f"V{data.shape[1]}")[:, 0].tolist()
            bag.write_many(np.array(numbers)[source[rows]], log_ns[rows], block.tolist())
