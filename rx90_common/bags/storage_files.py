"""Storage files of bags: mcap, sqlite3 and ROS 1; one that contradicts itself is refused.

A loop over messages in Python takes some 3 us for each, so compiled code finds those in a chunk of mcap.
"""

from __future__ import annotations

import sqlite3
import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from io import BytesIO
from operator import attrgetter, itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, TypeAlias
from zlib import crc32

import lz4.frame
import numpy as np
from backports import zstd
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from mcap.summary import Summary
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from rosbags.rosbag1 import Reader as Ros1Reader

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.limits import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    ROS1_MAGIC,
    DamagedError,
    check_length,
    check_ros1_chunks,
    library_errors,
    unpack_file,
)
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.kernels.compiled import c_function

ACCEPTED: Final = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, or a .csv, .parquet or .npz table"
)
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"  # with which no CDR message begins
_RECORD = struct.Struct("<BQ")  # op code and length
_RECORD_HEAD: Final = 9
_CHUNK = struct.Struct("<QQQII")  # first and last log time, bytes uncompressed, their checksum, bytes of a name
_MESSAGE: Final = 5  # op code
_MESSAGE_HEAD: Final = 22  # channel, sequence number, log time, time of publication
_INDEX = struct.Struct("<HI")  # channel, bytes of the entries
_ENTRY_BYTES = 16
_FOOTER = struct.Struct("<QQI")  # places of summary and offsets, checksum
_CDR = "cdr"
_ROS1 = "ros1"
_CHECKS = (
    "PRAGMA integrity_check(1)",  # tables against indexes, page by page
    "SELECT count(*) FROM messages WHERE typeof(id) != 'integer' OR typeof(timestamp) != 'integer' "
    "OR typeof(data) != 'blob' OR topic_id NOT IN (SELECT id FROM topics)",
    "SELECT count(*), min(id), max(id) FROM messages",
)
"""Query of a database before its messages are read."""

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
    """An open storage file, or an object that is read like one; the keys of `topics` are its own identifiers."""

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


def full_type(msgtype: str) -> str:
    """Return the name of a type as ROS 2 has it now: `sensor_msgs/JointState` is `sensor_msgs/msg/JointState`."""
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype


def _decompressed(content: bytes) -> bytes:
    """Return a message; one that is compressed begins as no CDR message does."""
    if not content.startswith(_ZSTD_MAGIC):
        return content
    frame = zstd.ZstdDecompressor()
    with library_errors("a compressed message: "):
        data = frame.decompress(content, MAX_MESSAGE_BYTES)
    if not frame.eof:
        raise DamagedError(f"a compressed message is cut off, or longer than {MAX_MESSAGE_BYTES:,} bytes")
    return data


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
        if beginning.startswith(_ZSTD_MAGIC):
            target = Path(stack.enter_context(TemporaryDirectory(prefix="rx90_bag_"))) / path.stem
            unpack_file(path, target)
            inner = open_storage(target, stack)
            inner.compression = "zstd files"
            return inner
    kind = next((kind for known, kind in _BEGINNINGS.items() if beginning.startswith(known)), None)
    if kind is None:
        fault = "is no bag, or damaged at its beginning" if beginning else "is empty"
        raise BagError(f"{fault}; accepted: {ACCEPTED}")
    file = kind(path)
    stack.callback(file.close)
    return file


class _McapFile(StorageFile):
    """An mcap file; refused if it is cut off, its records do not fill it, or its summary does not fit them."""

    kind = "mcap"

    def __init__(self, path: Path) -> None:
        self._data = np.memmap(path, np.uint8, "r").data
        magic = len(MCAP_MAGIC)
        with library_errors():
            if len(self._data) == magic or self._data[-magic:].tobytes() != MCAP_MAGIC:
                raise self._cut_off()
            self._rows = _records(self._data, magic, len(self._data) - magic)
            self._outside = self._rows[self._rows[:, 0] == Opcode.MESSAGE]  # messages in no chunk
            self._chunks: list[ChunkIndex] = []
            self.topics = self._topics(self._summary())
        self.compression = ", ".join(f"{kind} chunks" for kind in sorted({c.compression for c in self._chunks} - {""}))

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        wanted = sorted(self._chunks, key=attrgetter("message_start_time"))
        wanted = [c for c in wanted if not c.message_index_offsets or not {*keys}.isdisjoint(c.message_index_offsets)]
        pending = self._chosen(self._data, self._outside, keys)
        for k in range(-1, len(wanted)):
            if k >= 0:
                with library_errors(f"the chunk at byte {wanted[k].chunk_start_offset}: "):
                    pending += self._read_chunk(wanted[k], keys)
            pending.sort(key=itemgetter(1))
            end = len(pending)
            if k + 1 < len(wanted):  # the messages earlier than all later ones
                end = bisect_left(pending, wanted[k + 1].message_start_time, key=itemgetter(1))
            for key, log_ns, data in pending[:end]:  # one by one: together they may be more than the memory
                yield key, log_ns, _decompressed(data)
            pending = pending[end:]

    def _cut_off(self) -> BagError:
        """Return the error text for a file without its proper end, with the number of complete messages."""
        rows = _records(self._data, len(MCAP_MAGIC), len(self._data), whole=False)
        index = rows[rows[:, 0] == Opcode.MESSAGE_INDEX]
        chunks = rows[(rows[:, 0] == Opcode.CHUNK) & (rows[:, 3] < index[-1:, 3].sum())]  # complete ones
        if not len(chunks):
            return BagError("is cut off before its first whole chunk: nothing can be recovered")
        count = int(((index[:, 4] - index[:, 3]) // _ENTRY_BYTES).sum())
        end_ns = max(_CHUNK.unpack_from(self._data, begin)[1] for begin in chunks[:, 3].tolist())
        return BagError(
            f"is cut off (its recorder was killed, or the disk was full?): {count} messages up to t = "
            f"{end_ns / NANOSECONDS:.6f} s are whole, 'mcap recover' restores them"
        )

    def _summary(self) -> Summary:
        """Find the chunks; return the summary, once it fits them."""
        summary = Summary()
        held = Summary()
        crc = 0
        start = 0
        found = -1
        part = held
        for code, _, _, begin, end in self._rows[self._rows[:, 0] != Opcode.MESSAGE].tolist():
            if code == Opcode.CHUNK:
                self._chunks.append(_chunk_at(self._data, begin, end))
            elif code == Opcode.MESSAGE_INDEX:
                chunk = self._chunks[-1]
                chunk.message_index_offsets[_INDEX.unpack_from(self._data, begin)[0]] = begin - _RECORD_HEAD
                chunk.message_index_length = end - chunk.chunk_start_offset - chunk.chunk_length
            elif code == Opcode.DATA_END:
                part = summary
                start = end
            elif code == Opcode.FOOTER:
                found, _, crc = _FOOTER.unpack_from(self._data, begin)
            else:
                _note(part, code, self._data[begin:end].tobytes())
        if found not in (0, start):
            raise DamagedError("its footer does not lead to its summary")
        if found and crc and crc != crc32(self._data[found : -4 - len(MCAP_MAGIC)]):
            raise DamagedError("the checksum of its summary does not match")
        listed = sorted(summary.chunk_indexes, key=attrgetter("chunk_start_offset"))
        if listed and listed != self._chunks:
            raise DamagedError("its index is not that of its chunks")
        if not summary.channels:
            summary.schemas = held.schemas
            summary.channels = held.channels
        return summary

    def _topics(self, summary: Summary) -> dict[int, BagTopic]:
        """Return the topics in a summary, with its numbers of messages; without a summary, counted ones."""
        statistics = summary.statistics
        counts: dict[int, int] = Counter(self._outside[:, 1].tolist())
        if statistics is not None and summary.channels:
            counts = statistics.channel_message_counts
        else:
            for content in map(self._content, self._chunks):
                rows = _records(content)
                for code, channel, _, begin, end in rows.tolist():
                    if code == Opcode.MESSAGE:
                        counts[channel] += 1
                    else:
                        _note(summary, code, content[begin:end])
        total = sum(counts.values())
        if statistics is not None and statistics.message_count != total:
            raise DamagedError(f"its statistics say {statistics.message_count:,} messages, there are {total:,}")
        for lacking in (channel for channel, count in counts.items() if count and channel not in summary.channels):
            raise DamagedError(f"its summary lacks channel {lacking}, which has messages")
        topics = {}
        for key, channel in sorted(summary.channels.items()):
            schema = summary.schemas.get(channel.schema_id)
            if channel.schema_id and schema is None:
                raise DamagedError(f"{plain(channel.topic)} is of schema {channel.schema_id}, which is not there")
            msgtype = full_type(schema.name) if schema is not None else ""
            topics[key] = BagTopic(channel.topic, msgtype, counts.get(key, 0), channel.message_encoding)
        return topics

    def _content(self, chunk: ChunkIndex) -> bytes:
        """Return the content of a chunk, checked against its checksum; no more is decompressed than its head states."""
        size = chunk.uncompressed_size
        check_length("a chunk", size, MAX_CHUNK_BYTES)
        end = chunk.chunk_start_offset + chunk.chunk_length
        crc = _CHUNK.unpack_from(self._data, chunk.chunk_start_offset + _RECORD_HEAD)[3]
        data = self._data[end - chunk.compressed_size : end].tobytes()
        if chunk.compression == "zstd":
            data = zstd.ZstdDecompressor().decompress(data, size + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        elif chunk.compression:
            raise DamagedError(f"a chunk is compressed by {plain(chunk.compression)}; accepted: zstd, lz4")
        if len(data) != size:
            how = "longer" if len(data) > size else "shorter"
            raise DamagedError(f"a chunk is {how} than {size:,} bytes, which its head says")
        if crc and crc != crc32(data):
            raise DamagedError("the checksum of a chunk does not match")
        return data

    def _read_chunk(self, chunk: ChunkIndex, keys: Collection[int]) -> list[LoggedMessage]:
        """Return messages of a chunk, all of which are checked against its head and the indexes after it."""
        content = self._content(chunk)
        where = f"the chunk at byte {chunk.chunk_start_offset}"
        rows = _records(content)
        rows = rows[rows[:, 0] == Opcode.MESSAGE]
        times = chunk.message_start_time, chunk.message_end_time
        if len(rows) and (int(rows[:, 2].min()), int(rows[:, 2].max())) != times:
            raise DamagedError(f"the messages of {where} have other times than its head says")
        for channel, at in chunk.message_index_offsets.items():
            end = at + _RECORD_HEAD + _RECORD.unpack_from(self._data, at)[1]
            begin = at + _RECORD_HEAD + _INDEX.size
            entries = np.frombuffer(self._data[begin:end], "<i8").reshape(-1, 2)
            found = rows[rows[:, 1] == channel, 2:4] - np.array([0, _RECORD_HEAD])
            ordered = entries[np.argsort(entries[:, 1], kind="stable")]
            if _INDEX.unpack_from(self._data, begin - _INDEX.size)[1] != end - begin or (ordered != found).any():
                raise DamagedError(f"the index of {where} is not that of its messages")
        return self._chosen(content, rows, keys)

    def _chosen(self, content: bytes | memoryview, rows: Int64Array, keys: Collection[int]) -> list[LoggedMessage]:
        """Return the messages of these channels, compressed ones as they are."""
        rows = rows[np.isin(rows[:, 1], list(keys))]
        if len(rows):
            check_length("a message", int((rows[:, 4] - rows[:, 3]).max()) - _MESSAGE_HEAD, MAX_MESSAGE_BYTES)
        messages = [(key, ns, bytes(content[begin + _MESSAGE_HEAD : end])) for _, key, ns, begin, end in rows.tolist()]
        if any(data.startswith(_ZSTD_MAGIC) for _, _, data in messages):
            self.compression = "zstd messages"
        return messages


@c_function(types.int64(types.voidptr, types.int64, types.voidptr, types.int64))
def _find_records(data_at, size, rows_at, room):  # type: ignore[no-untyped-def]  # addresses
    """Write rows as `_records` gives them, as far as there is room; return how many whole records there are."""
    data = carray(data_at, (size,), np.uint8)
    rows = carray(rows_at, (room, 5), np.int64)
    count = at = 0
    while size - at >= _RECORD_HEAD:
        begin = at + _RECORD_HEAD
        length = np.int64(0)
        for k in range(8):
            length |= np.int64(data[at + 1 + k]) << (8 * k)
        is_message = data[at] == _MESSAGE
        if length < 0 or length > size - begin or (is_message and length < _MESSAGE_HEAD):
            break
        if count < room:
            channel = np.int64(0)
            log_ns = np.int64(0)
            if is_message:
                channel = np.int64(data[begin]) | np.int64(data[begin + 1]) << 8
                for k in range(8):
                    log_ns |= np.int64(data[begin + 6 + k]) << (8 * k)
            rows[count, 0] = data[at]
            rows[count, 1] = channel
            rows[count, 2] = log_ns
            rows[count, 3] = begin
            rows[count, 4] = begin + length
        count += 1
        at = int(begin + length)
    return count


def _records(content: bytes | memoryview, first: int = 0, last: int | None = None, *, whole: bool = True) -> Int64Array:
    """Return op code, channel, log time, begin and end of the content of each mcap record, (n, 5); 0 for other records.

    Raises:
        DamagedError: if these do not fill the bytes exactly.
    """
    part = np.frombuffer(content, np.uint8)[first:last]
    rows = np.empty((_find_records(part.ctypes.data, len(part), part.ctypes.data, 0), 5), dtype=np.int64)
    _find_records(part.ctypes.data, len(part), rows.ctypes.data, len(rows))
    if whole and (rows[-1, 4] if len(rows) else 0) != len(part):
        raise DamagedError("its records do not fill it")
    rows[:, 3:] += first
    return rows


def _chunk_at(data: memoryview, begin: int, end: int) -> ChunkIndex:
    """Return the index of the chunk with this content, without that of its messages, which follows it."""
    first_ns, last_ns, size, _, length = _CHUNK.unpack_from(data, begin)
    name = begin + _CHUNK.size
    (compressed,) = struct.unpack_from("<Q", data, name + length)
    begin = begin - _RECORD_HEAD
    compression = data[name : name + length].tobytes().decode()
    return ChunkIndex(end - begin, begin, compression, compressed, last_ns, 0, {}, first_ns, size)


class _WholeStream(ReadDataStream):
    """The library's stream, in which a record that is cut off is an error."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise DamagedError("a record of its summary is cut off")
        return data


def _note(summary: Summary, code: int, content: bytes) -> None:
    """Note in a summary the record of a schema, a channel, a chunk, or of all messages."""
    stream = _WholeStream(BytesIO(content))
    if code == Opcode.SCHEMA:
        schema = Schema.read(stream)
        summary.schemas[schema.id] = schema
    elif code == Opcode.CHANNEL:
        channel = Channel.read(stream)
        summary.channels[channel.id] = channel
    elif code == Opcode.CHUNK_INDEX:
        summary.chunk_indexes.append(ChunkIndex.read(stream))
    elif code == Opcode.STATISTICS:
        summary.statistics = Statistics.read(stream)


class _SqliteFile(StorageFile):
    """A database of rosbag2; a journal beside it is ignored, and a database of another kind is refused."""

    kind = "db3"

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        self.close = self._database.close  # type: ignore[method-assign]
        try:
            with library_errors():
                self.topics = self._topics()
        except DamagedError:
            self.close()
            raise

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        with library_errors():  # also MemoryError, of a length that is damaged
            (found,), (foreign,), (count, first, last) = (self._database.execute(one).fetchone() for one in _CHECKS)
            if found != "ok":
                raise DamagedError(plain(found))
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
                if data.startswith(_ZSTD_MAGIC):
                    self.compression = "zstd messages"
                yield key, log_ns, _decompressed(data)

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
        with library_errors():
            self._reader.open()
        self.close = self._reader.close  # type: ignore[method-assign]
        self.topics = {
            c.id: BagTopic(c.topic, full_type(c.msgtype), c.msgcount, _ROS1) for c in self._reader.connections
        }

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
