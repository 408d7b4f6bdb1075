"""Storage files of bags: mcap by the mcap library's records, databases by SQLite, bags of ROS 1 by rosbags.

Each file is read by its index if it has one, and held against its checksums, counts and tables. The messages in a
chunk of mcap are found here: the library takes some 15 us for each.
"""

from __future__ import annotations

import os
import sqlite3
import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from io import BytesIO
from operator import attrgetter, itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Final, TypeAlias
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from rosbags.rosbag1 import Reader as Ros1Reader

from rx90_common.bags.limits import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    ROS1_MAGIC,
    ZSTD_MAGIC,
    DamagedError,
    check_length,
    check_ros1_chunks,
    check_whole,
    library_errors,
    unpack_chunk,
    unpack_file,
    unpack_message,
)
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS

ACCEPTED: Final = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, or a .csv, .parquet or .npz table"
)
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_MAX_SUMMARY_BYTES = 256 << 20
_LAST_NS = 2**64
_RECORD = struct.Struct("<BQ")  # op code and length
_MESSAGE = struct.Struct("<BQHIQQ")  # the same, channel, sequence number, log time, time of publication
_FOOTER = struct.Struct("<QQI")  # places of summary and offsets, checksum
_CDR = "cdr"
_ROS1 = "ros1"
# Queries of a database before its messages are read.
_INTEGRITY = "PRAGMA integrity_check(1)"  # tables against indexes, page by page
_FOREIGN = (
    "SELECT count(*) FROM messages WHERE typeof(id) != 'integer' OR typeof(timestamp) != 'integer' "
    "OR typeof(data) != 'blob' OR topic_id NOT IN (SELECT id FROM topics)"
)
_NUMBERS = "SELECT count(*), min(id), max(id) FROM messages"

LoggedMessage: TypeAlias = tuple[int, int, bytes]
"""Key of the topic, log time in ns, message."""


@dataclass(frozen=True)
class BagTopic:
    """A topic as a bag lists it; `encoding` is that of its messages, such as cdr."""

    name: str
    msgtype: str
    count: int
    encoding: str = _CDR

    @property
    def identity(self) -> tuple[str, str, str]:
        """Return the properties that a topic must have in all files of a bag."""
        return self.name, self.msgtype, self.encoding

    @property
    def is_known(self) -> bool:
        """Return whether its messages are serialised as ROS 2 or ROS 1 do it."""
        return self.encoding in (_CDR, _ROS1)

    @property
    def is_joint_state(self) -> bool:
        """Return whether its messages can be read as joint states."""
        return self.msgtype == JOINT_STATE and self.is_known

    @property
    def description(self) -> str:
        """Return its type in one line, with the encoding of its messages where that is not ROS 2's."""
        kind = plain(self.msgtype) or "without a type"
        return kind if self.is_known else f"{kind} in {plain(self.encoding) or 'no encoding'}"

    @property
    def is_ros1(self) -> bool:
        """Return whether its messages are serialised as ROS 1 does it."""
        return self.encoding == _ROS1


class StorageFile:
    """A storage file; the keys of `topics` are its own identifiers."""

    kind: str
    compression = ""
    topics: dict[int, BagTopic]

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these topics in the order of log time, equal times in that of writing.

        Raises:
            DamagedError: if they do not fit the checksums, tables and indexes of the file.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Close it."""

    def _message(self, data: bytes) -> bytes:
        """Return a message, unpacked; one that is compressed begins as no CDR message does."""
        if not data.startswith(ZSTD_MAGIC):
            return data
        self.compression = "zstd messages"
        return unpack_message(data)


def full_type(msgtype: str) -> str:
    """Return the name of a type as ROS 2 has it now: `sensor_msgs/JointState` is `sensor_msgs/msg/JointState`."""
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype


def open_storage(path: Path, stack: ExitStack) -> StorageFile:
    """Open a storage file of the kind that its first bytes show; a compressed one is decompressed to a temporary file.

    Args:
        path: of the file, with any name.
        stack: closes it.

    Raises:
        DamagedError: if it contradicts itself.
    """
    for suffix in ("-journal", "-wal"):  # reading a database with one alone would show a torn state
        with suppress(OSError):  # there is none, or its name would be too long to be one
            if Path(f"{path}{suffix}").stat().st_size:
                raise BagError(
                    f"was not closed (its recorder was killed?); sqlite3 restores {path.name} up to its last commit "
                    "when it is opened for writing, and 'ros2 bag reindex' then writes the metadata"
                )
    with path.open("rb") as stream:
        beginning = stream.read(max(map(len, _BEGINNINGS)))
        if beginning.startswith(ZSTD_MAGIC):
            target = Path(stack.enter_context(TemporaryDirectory(prefix="rx90_bag_"))) / path.stem
            unpack_file(path, target)
            inner = open_storage(target, stack)
            inner.compression = "zstd files"
            return inner
    kind = next((kind for known, kind in _BEGINNINGS.items() if beginning.startswith(known)), None)
    if kind is None:
        fault = "is no bag, or damaged at its beginning" if beginning else "is empty"
        raise BagError(f"{fault}; accepted: {ACCEPTED}")
    with library_errors():
        file = kind(path)
    stack.callback(file.close)
    return file


class _McapFile(StorageFile):
    """An mcap file; refused if it is cut off, or its records do not have its counts and checksums."""

    kind = "mcap"

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as stream:
            size = stream.seek(-len(MCAP_MAGIC), os.SEEK_END)
            if not size or stream.read() != MCAP_MAGIC:
                raise self._cut_off()
            summary = _summary(stream)
        self._chunks = sorted(summary.chunk_indexes, key=attrgetter("message_start_time"))
        if sum(index.chunk_length for index in self._chunks) > size:
            raise DamagedError("its index has more chunks than it can hold")
        check_whole(path, "chunks", sum(index.uncompressed_size for index in self._chunks))
        counts: dict[int, int] = Counter()
        if summary.statistics is not None and summary.channels:
            counts = summary.statistics.channel_message_counts
        else:
            for record in self._records():
                if isinstance(record, Message):
                    counts[record.channel_id] += 1
                else:
                    _note(summary, record)
        for lacking in (key for key, count in counts.items() if count and key not in summary.channels):
            raise DamagedError(f"its summary lacks channel {lacking}, which has messages")
        self.topics = {}
        for key, channel in sorted(summary.channels.items()):
            schema = summary.schemas.get(channel.schema_id)
            if channel.schema_id and schema is None:
                raise DamagedError(f"{plain(channel.topic)} is of schema {channel.schema_id}, which is not there")
            msgtype = full_type(schema.name) if schema is not None else ""
            self.topics[key] = BagTopic(channel.topic, msgtype, counts.get(key, 0), channel.message_encoding)

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        pending: list[LoggedMessage] = []
        with library_errors():
            for part, next_ns in self._parts(keys):
                check_length("a message", max((len(data) for _, _, data in part), default=0), MAX_MESSAGE_BYTES)
                pending += part
                pending.sort(key=itemgetter(1))
                end = bisect_left(pending, next_ns, key=itemgetter(1))
                for key, log_ns, data in pending[:end]:
                    yield key, log_ns, self._message(data)
                pending = pending[end:]

    def _parts(self, keys: Collection[int]) -> Iterator[tuple[list[LoggedMessage], int]]:
        """Yield messages of these channels by chunk, each with the first time of the later chunks."""
        if not self._chunks:
            messages = [record for record in self._records() if isinstance(record, Message)]
            logged = ((message.channel_id, message.log_time, message.data) for message in messages)
            yield [message for message in logged if message[0] in keys], _LAST_NS
            return
        chunks = [
            index
            for index in self._chunks
            if not index.message_index_offsets or not index.message_index_offsets.keys().isdisjoint(keys)
        ]
        starts = [index.message_start_time for index in chunks]
        with self._path.open("rb") as stream:
            for k, index in enumerate(chunks, 1):
                with library_errors(f"the chunk at byte {index.chunk_start_offset}: "):
                    stream.seek(index.chunk_start_offset)
                    code, length = _RECORD.unpack(stream.read(_RECORD.size))
                    if code != Opcode.CHUNK or length + _RECORD.size != index.chunk_length:
                        raise DamagedError("its index leads to no chunk")
                    check_length("a chunk", length, MAX_CHUNK_BYTES)
                    chunk = Chunk.read(ReadDataStream(stream))
                    if chunk.uncompressed_size != index.uncompressed_size:
                        raise DamagedError("its index states another length")
                    part = _messages_in(self._content(chunk), keys)
                    if not all(chunk.message_start_time <= log_ns <= chunk.message_end_time for _, log_ns, _ in part):
                        raise DamagedError("its messages have other times than its head says")
                yield part, starts[k] if k < len(starts) else _LAST_NS

    def _content(self, chunk: Chunk) -> bytes:
        if chunk.compression:
            self.compression = f"{chunk.compression} chunks"
        return unpack_chunk(chunk)

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records of the file, and those in its chunks, as they stand in it."""
        with self._path.open("rb") as stream:
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES)
            whole = 0
            for record in reader.records:
                if isinstance(record, Chunk):
                    whole += record.uncompressed_size
                    check_whole(self._path, "chunks", whole)
                    yield from breakup_chunk(replace(record, data=self._content(record), compression=""))
                else:
                    yield record

    def _cut_off(self) -> BagError:
        """Return the error for a file without its proper end, with the number of whole messages."""
        count = 0
        end_ns = 0
        with suppress(Exception):  # where it is cut off
            for record in self._records():
                if isinstance(record, Message):
                    count += 1
                    end_ns = max(end_ns, record.log_time)
        if not count:
            return BagError("is cut off before its first whole chunk: nothing can be recovered")
        return BagError(
            f"is cut off (its recorder was killed, or the disk was full?): {count} messages up to t = "
            f"{end_ns / NANOSECONDS:.6f} s are whole, 'mcap recover' restores them"
        )


def _summary(stream: BinaryIO) -> Summary:
    """Return the summary of an mcap file, empty if it has none; checked against its checksum."""
    summary = Summary()
    stream.seek(-_FOOTER.size - len(MCAP_MAGIC), os.SEEK_END)
    start, _, crc = _FOOTER.unpack(stream.read(_FOOTER.size))
    if start:
        size = stream.seek(0, os.SEEK_END)
        check_length("its summary", size - start, _MAX_SUMMARY_BYTES)
        stream.seek(start)
        content = stream.read()
        if crc not in (0, crc32(content[: -len(MCAP_MAGIC) - 4])):
            raise DamagedError("the checksum of its summary does not match")
        reader = StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True, record_size_limit=len(content))
        for record in reader.records:
            _note(summary, record)
    return summary


def _note(summary: Summary, record: McapRecord) -> None:
    """Note in a summary the record of a schema, a channel, a chunk, or of all messages."""
    if isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record
    elif isinstance(record, ChunkIndex):
        summary.chunk_indexes.append(record)
    elif isinstance(record, Statistics):
        summary.statistics = record


def _messages_in(content: bytes, keys: Collection[int]) -> list[LoggedMessage]:
    """Return the messages of these channels in the content of a chunk."""
    messages = []
    at = 0
    size = len(content)
    while at < size:
        end = at + _RECORD.size
        if content[at] == Opcode.MESSAGE:
            _, length, channel, _, log_ns, _ = _MESSAGE.unpack_from(content, at)
            end += length
            if channel in keys:
                messages.append((channel, log_ns, content[at + _MESSAGE.size : end]))
        elif content[at]:  # schemas and channels
            end += _RECORD.unpack_from(content, at)[1]
        else:
            break
        at = end
    if at != size:
        raise DamagedError("its records do not fill it")
    return messages


class _SqliteFile(StorageFile):
    """A database of rosbag2; a journal beside it is ignored, and a database of another kind is refused."""

    kind = "db3"

    def __init__(self, path: Path) -> None:
        with ExitStack() as stack:
            self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
            stack.callback(self._database.close)
            self.topics = self._topics()
            stack.pop_all()

    def close(self) -> None:
        self._database.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        with library_errors():  # also MemoryError, of a length that is damaged
            (verdict,) = self._database.execute(_INTEGRITY).fetchone()
            (foreign,) = self._database.execute(_FOREIGN).fetchone()
            count, first, last = self._database.execute(_NUMBERS).fetchone()
            if verdict != "ok":
                raise DamagedError(plain(verdict))
            if foreign:
                raise DamagedError(f"{foreign:,} messages are of no topic, or have no number, time or content")
            if count and (lost := last - min(first, 1) + 1 - count):  # rows are numbered from 1 on
                raise DamagedError(
                    f"{lost:,} messages are gone: the last one has number {last:,}, {count:,} are there; "
                    "'ros2 bag convert' makes a bag of these"
                )
            places = ", ".join("?" for _ in keys)
            longest = f"SELECT max(length(data)) FROM messages WHERE topic_id IN ({places})"
            (size,) = self._database.execute(longest, list(keys)).fetchone()
            check_length("a message", size or 0, MAX_MESSAGE_BYTES)
            chosen = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
            for key, log_ns, data in self._database.execute(f"{chosen} ORDER BY timestamp, id", list(keys)):
                yield key, log_ns, self._message(data)

    def _topics(self) -> dict[int, BagTopic]:
        tables = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise DamagedError("a database without the tables topics and messages; accepted: one of rosbag2")
        query = (
            "SELECT topics.id, name, type, serialization_format, count(messages.id) "
            "FROM topics LEFT JOIN messages ON topics.id = messages.topic_id GROUP BY topics.id ORDER BY topics.id"
        )
        rows = self._database.execute(query).fetchall()
        if not all(isinstance(text, str) for row in rows for text in row[1:4]):
            raise DamagedError("a topic's name, type or encoding is no text")
        return {key: BagTopic(name, full_type(kind), count, form) for key, name, kind, form, count in rows}


class _Ros1File(StorageFile):
    """A bag file of ROS 1, by rosbags."""

    kind = "bag"

    def __init__(self, path: Path) -> None:
        check_ros1_chunks(path)
        self._reader = Ros1Reader(path)
        self._reader.open()
        self.topics = {
            c.id: BagTopic(c.topic, full_type(c.msgtype), c.msgcount, _ROS1) for c in self._reader.connections
        }

    def close(self) -> None:
        self._reader.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        wanted = [connection for connection in self._reader.connections if connection.id in keys]
        with library_errors():
            # To rosbags no connections are all of them.
            for connection, log_ns, data in self._reader.messages(wanted) if wanted else ():
                yield connection.id, log_ns, data


_BEGINNINGS: Final[dict[bytes, Callable[[Path], StorageFile]]] = {
    MCAP_MAGIC: _McapFile,
    b"SQLite format 3\0": _SqliteFile,
    ROS1_MAGIC: _Ros1File,
}
