"""Storage files of bags: mcap, sqlite3 and ROS 1; one that contradicts itself is refused.

The library of the mcap project reads mcap files. Its loop over messages takes some 3 us for each of them, so that
compiled code finds those of a chunk; a file whose index does not lead to all chunks is read through by the library.
"""

from __future__ import annotations

import mmap
import shutil
import sqlite3
import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final, Protocol, TypeAlias, cast
from zlib import crc32

import lz4.frame
import numpy as np
from backports import zstd
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from numba import carray, types  # type: ignore[attr-defined]  # numba exports without saying so
from rosbags.rosbag1 import Reader as Ros1Reader

from rx90_common.bags.batch import Int64Array
from rx90_common.bags.topics import JOINT_STATE, TEMPERATURE
from rx90_common.base.errors import BagError, write_error
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.kernels.compiled import c_function

ACCEPTED: Final = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, or a .csv, .parquet or .npz table"
)
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"  # with which no CDR message begins
_MAX_MESSAGE_BYTES = 256 << 20  # of a compressed message; nothing beside it says how long it is
_COPY_BYTES = 1 << 20
_FOOTER = struct.Struct("<QQI")
_RECORD_HEAD: Final = 9  # op code and length
_MESSAGE_HEAD: Final = 22  # channel, sequence number, log time, time of publication
_INDEX_HEAD = struct.Struct("<BQHI")  # op code and length, channel, bytes of the entries
_MESSAGE: Final = 5  # op code
_CDR, _ROS1 = "cdr", "ros1"

LoggedMessage: TypeAlias = tuple[int, int, bytes]
"""Key of the topic, log time in ns, message."""


class DamagedError(Exception):
    """A storage file contradicts itself; the text says where, for the reader of the bag to put the file before it."""


@dataclass(frozen=True)
class BagTopic:
    """A topic as a bag lists it; `encoding` is that of its messages, such as cdr."""

    name: str
    msgtype: str
    count: int
    encoding: str = _CDR

    @property
    def identity(self) -> tuple[str, str, str]:
        """Return what the same topic has in common in all files of a bag."""
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
    def holds_series(self) -> bool:
        """Return whether its messages can be read as a series: joint states or temperatures."""
        return self.msgtype in (JOINT_STATE, TEMPERATURE) and self.is_known

    @property
    def description(self) -> str:
        """Return its type in one line, with the encoding of its messages where that is not ROS 2's."""
        kind = plain(self.msgtype) or "without a type"
        return kind if self.is_known else f"{kind} in {plain(self.encoding) or 'no encoding'}"

    @property
    def is_ros1(self) -> bool:
        """Return whether its messages are serialised as ROS 1 does it."""
        return self.encoding == _ROS1


class StorageFile(Protocol):
    """A storage file that is open, or what is read like one."""

    kind: str
    compression: str
    topics: dict[int, BagTopic]  # by what the file knows them by

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these topics in the order of log time."""

    def close(self) -> None:
        """Close it."""


def full_type(msgtype: str) -> str:
    """Return the name of a type as ROS 2 has it now: `sensor_msgs/JointState` is `sensor_msgs/msg/JointState`."""
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype


@contextmanager
def library_errors(where: str = "") -> Iterator[None]:
    """Make one DamagedError of whatever a library raises for bytes that it cannot read."""
    try:
        yield
    except DamagedError:
        raise
    except Exception as error:  # the libraries have no common error
        text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        raise DamagedError(plain(where + text, 300)) from error


def _decompressed(content: bytes) -> bytes:
    """Return a message; one that is compressed begins as no CDR message does."""
    if not content.startswith(_ZSTD_MAGIC):
        return content
    frame = zstd.ZstdDecompressor()
    with library_errors("a compressed message: "):
        data = frame.decompress(content, _MAX_MESSAGE_BYTES)
    if not frame.eof:
        raise DamagedError(f"a compressed message is cut off, or longer than {_MAX_MESSAGE_BYTES:,} bytes")
    return data


def open_storage(path: Path, stack: ExitStack) -> StorageFile:
    """Open a storage file by what it begins with; one that is compressed is decompressed to a temporary file first.

    Args:
        path: of the file, whatever it is called.
        stack: closes it.

    Raises:
        BagError: if it is no storage file, or was not closed.
        DamagedError: if it contradicts itself.
        Rx90Error: if there is no room to decompress it.
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
            stream.seek(0)
            _decompress_file(stream, target)
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


def _decompress_file(source: IO[bytes], target: Path) -> None:
    try:
        with zstd.open(source, "rb") as content, target.open("wb") as stream:
            shutil.copyfileobj(content, stream, _COPY_BYTES)
    except (zstd.ZstdError, EOFError) as error:
        raise DamagedError(f"{error}") from error
    except OSError as error:
        raise write_error(target, error) from error


class McapFile:
    """An mcap file that is open.

    Args:
        path: of the file.

    Raises:
        BagError: if it is cut off, with how much of it is whole.
        DamagedError: if its summary cannot be read, or contradicts itself.
    """

    kind = "mcap"

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            _refuse_cut_off(stream)
            self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        self._without_index: list[LoggedMessage] = []
        try:
            with library_errors():
                summary = self._summary()
                if not _leads_to_all(summary):
                    summary = self._read_through(summary)
                self.topics = _topics(summary)
        except BaseException:
            self._data.close()
            raise
        self._chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.message_start_time)
        self.compression = ", ".join(f"{kind} chunks" for kind in sorted({c.compression for c in self._chunks} - {""}))

    def close(self) -> None:
        """Close the file."""
        self._data.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these channels in the order of log time, equal times as they stand in the file.

        Raises:
            DamagedError: if a chunk, its checksum, its index and that of the file do not fit together.
        """
        yield from (message for message in self._without_index if message[0] in keys)
        chunks = [
            c for c in self._chunks if not c.message_index_offsets or not {*keys}.isdisjoint(c.message_index_offsets)
        ]
        pending: list[LoggedMessage] = []
        for i, chunk in enumerate(chunks):
            with library_errors(f"the chunk at byte {chunk.chunk_start_offset}: "):
                pending += self._read_chunk(chunk, keys)
            pending.sort(key=itemgetter(1))
            end = len(pending)
            if i + 1 < len(chunks):  # what is earlier than all that follows
                end = bisect_left(pending, chunks[i + 1].message_start_time, key=itemgetter(1))
            yield from pending[:end]
            pending = pending[end:]

    def _summary(self) -> Summary:
        """Return the summary, whose checksum the library does not look at; an empty one where there is none."""
        start, _, crc = _FOOTER.unpack(self._data[-_FOOTER.size - len(MCAP_MAGIC) : -len(MCAP_MAGIC)])
        if start and crc and crc != crc32(self._data[start : -4 - len(MCAP_MAGIC)]):
            raise DamagedError("the checksum of its summary does not match")
        self._data.seek(0)
        return SeekingReader(cast("IO[bytes]", self._data)).get_summary() or Summary()

    def _read_through(self, listed: Summary) -> Summary:
        """Read all messages into memory; return the summary of a file whose own does not lead to all of them."""
        found = Summary()
        self._data.seek(0)
        for record in StreamReader(cast("IO[bytes]", self._data), validate_crcs=True, emit_chunks=True).records:
            whole = replace(record, compression="", data=_content(record)) if isinstance(record, Chunk) else None
            for one in [record] if whole is None else breakup_chunk(whole):
                if isinstance(one, Schema):
                    found.schemas[one.id] = one
                elif isinstance(one, Channel):
                    found.channels[one.id] = one
                elif isinstance(one, Message):
                    self._without_index.append((one.channel_id, one.log_time, _decompressed(one.data)))
        self._without_index.sort(key=itemgetter(1))
        counts = Counter(key for key, _, _ in self._without_index)
        if listed.statistics is not None and listed.statistics.message_count != counts.total():
            total = listed.statistics.message_count
            raise DamagedError(f"its statistics say {total:,} messages, there are {counts.total():,}")
        _check_channels(listed.channels or found.channels, counts)
        found.statistics = Statistics(0, 0, dict(counts), 0, 0, 0, 0, 0, 0)
        return found

    def _read_chunk(self, listed: ChunkIndex, keys: Collection[int]) -> list[LoggedMessage]:
        """Return messages of a chunk, which is held against its checksum, its head and both indexes."""
        start, end = listed.chunk_start_offset, listed.chunk_start_offset + listed.chunk_length
        self._data.seek(start)
        head = self._data.read(_RECORD_HEAD)
        chunk = Chunk.read(ReadDataStream(cast("IO[bytes]", self._data)))
        if head != struct.pack("<BQ", Opcode.CHUNK, listed.chunk_length - _RECORD_HEAD) or self._data.tell() != end:
            raise DamagedError("its index is not that of its chunks")
        content = _content(chunk)
        rows = _messages_in(content)
        _check_index(listed, chunk, rows, self._data[end : end + listed.message_index_length])
        rows = rows[np.isin(rows[:, 0], list(keys))]
        messages = [(key, log_ns, content[begin:end]) for key, log_ns, _, begin, end in rows.tolist()]
        if _ZSTD_MAGIC in content and any(data.startswith(_ZSTD_MAGIC) for _, _, data in messages):
            self.compression = "zstd messages"
            messages = [(key, log_ns, _decompressed(data)) for key, log_ns, data in messages]
        return messages


def _refuse_cut_off(stream: IO[bytes]) -> None:
    """Refuse an mcap file that does not end as one, with what of it is whole."""
    stream.seek(-len(MCAP_MAGIC), 2)
    if stream.tell() and stream.read() == MCAP_MAGIC:
        return
    stream.seek(0)
    count = end_ns = last_ns = 0
    with suppress(Exception):  # where the file ends, within a record
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                last_ns = max(last_ns, record.message_end_time)
            elif isinstance(record, MessageIndex):
                count, end_ns = count + len(record.records), last_ns
    if not count:
        raise BagError("is cut off before its first whole chunk: nothing can be recovered")
    raise BagError(
        f"is cut off (its recorder was killed, or the disk was full?): {count} messages up to t = "
        f"{end_ns / NANOSECONDS:.6f} s are whole, 'mcap recover' restores them"
    )


def _leads_to_all(summary: Summary) -> bool:
    """Return whether a summary counts the messages of each channel and lists as many chunks as there are."""
    statistics = summary.statistics
    if statistics is None or sum(statistics.channel_message_counts.values()) != statistics.message_count:
        return False
    listed = len(summary.chunk_indexes)
    if listed not in (0, statistics.chunk_count):
        raise DamagedError(f"its statistics say {statistics.chunk_count:,} chunks, {listed:,} are listed")
    if summary.channels:
        _check_channels(summary.channels, statistics.channel_message_counts)
    return bool(summary.channels) and (listed > 0 or not statistics.message_count)


def _check_channels(channels: Collection[int], counts: dict[int, int]) -> None:
    for channel, count in counts.items():
        if count and channel not in channels:
            raise DamagedError(f"its summary lacks channel {channel}, which has messages")


def _topics(summary: Summary) -> dict[int, BagTopic]:
    counts = summary.statistics.channel_message_counts if summary.statistics is not None else {}
    topics = {}
    for key, channel in sorted(summary.channels.items()):
        schema = summary.schemas.get(channel.schema_id)
        if channel.schema_id and schema is None:
            raise DamagedError(f"{plain(channel.topic)} is of schema {channel.schema_id}, which is not there")
        msgtype = full_type(schema.name) if schema is not None else ""
        topics[key] = BagTopic(channel.topic, msgtype, counts.get(key, 0), channel.message_encoding)
    return topics


def _content(chunk: Chunk) -> bytes:
    """Return what a chunk holds; unlike the library, without decompressing more than its head says."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        data = zstd.ZstdDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise DamagedError(f"a chunk is compressed by {plain(chunk.compression)}; accepted: zstd, lz4")
    if len(data) != size:
        how = "longer" if len(data) > size else "shorter"
        raise DamagedError(f"a chunk is {how} than {size:,} bytes, which its head says")
    if chunk.uncompressed_crc and chunk.uncompressed_crc != crc32(data):
        raise DamagedError("the checksum of a chunk does not match")
    return data


@c_function(types.int64(types.voidptr, types.int64, types.voidptr))
def _find_messages(data_at, size, rows_at):  # type: ignore[no-untyped-def]  # addresses
    """Write channel, log time, place of the record, begin and end of each message; return how many, -1 for others."""
    data = carray(data_at, (size,), np.uint8)
    rows = carray(rows_at, (size // (_RECORD_HEAD + _MESSAGE_HEAD), 5), np.int64)
    count = at = 0
    while at < size:
        if size - at < _RECORD_HEAD:
            return -1
        begin = at + _RECORD_HEAD
        length = np.int64(0)
        for k in range(8):
            length |= np.int64(data[at + 1 + k]) << (8 * k)
        if length < 0 or length > size - begin or (data[at] == _MESSAGE and length < _MESSAGE_HEAD):
            return -1
        if data[at] == _MESSAGE:
            log_ns = np.int64(0)
            for k in range(8):
                log_ns |= np.int64(data[begin + 6 + k]) << (8 * k)
            rows[count, 0] = np.int64(data[begin]) | np.int64(data[begin + 1]) << 8
            rows[count, 1], rows[count, 2] = log_ns, at
            rows[count, 3], rows[count, 4] = begin + _MESSAGE_HEAD, begin + length
            count += 1
        at = int(begin + length)
    return count


def _messages_in(content: bytes) -> Int64Array:
    """Return channel, log time, place of the record, begin and end of each message in a chunk, shape (n, 5)."""
    data = np.frombuffer(content, dtype=np.uint8)
    rows = np.empty((len(data) // (_RECORD_HEAD + _MESSAGE_HEAD), 5), dtype=np.int64)
    count = _find_messages(data.ctypes.data, len(data), rows.ctypes.data)
    if count < 0:
        raise DamagedError("its records do not fill it")
    return rows[:count]


def _check_index(listed: ChunkIndex, chunk: Chunk, rows: Int64Array, section: bytes) -> None:
    """Hold what was read of a chunk against its head, the index behind it and the file's: others follow these.

    Args:
        listed: the file's index of the chunk.
        chunk: with its head.
        rows: the messages in it, as `_messages_in` gives them.
        section: the index behind it.
    """
    head = (chunk.message_start_time, chunk.message_end_time)
    sizes = (chunk.compression, len(chunk.data), chunk.uncompressed_size)
    if (*head, *sizes) != (
        listed.message_start_time, listed.message_end_time, listed.compression, listed.compressed_size,
        listed.uncompressed_size,
    ):  # fmt: skip
        raise DamagedError("its index is not that of its chunks")
    where = f"the chunk at byte {listed.chunk_start_offset}"
    if len(rows) and (int(rows[:, 1].min()), int(rows[:, 1].max())) != head:
        raise DamagedError(f"the messages of {where} have other times than its head says")
    places, at = {}, 0
    while at < len(section):
        code, length, channel, size = _INDEX_HEAD.unpack_from(section, at)
        entries = np.frombuffer(section, "<i8", size // 8, at + _INDEX_HEAD.size).reshape(-1, 2)
        found = rows[rows[:, 0] == channel, 1:3]
        if (code, length) != (Opcode.MESSAGE_INDEX, size + _INDEX_HEAD.size - _RECORD_HEAD) or not np.array_equal(
            entries[np.argsort(entries[:, 1], kind="stable")], found
        ):
            raise DamagedError(f"the index of {where} is not that of its messages")
        places[channel] = listed.chunk_start_offset + listed.chunk_length + at
        at += _RECORD_HEAD + length
    if listed.message_index_offsets != places or (places and not np.isin(rows[:, 0], list(places)).all()):
        raise DamagedError("its index is not that of its chunks")


class SqliteFile:
    """A database of rosbag2 that is open for reading; a journal beside it is not looked at.

    Args:
        path: of the file.

    Raises:
        DamagedError: if it cannot be read, or is the database of something else.
    """

    kind = "db3"
    compression = ""

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            with library_errors():
                self.topics = self._topics()
        except DamagedError:
            self._database.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these topics in the order of log time, equal times in that of writing.

        Raises:
            DamagedError: if tables and indexes do not fit together, or messages were deleted.
        """
        with library_errors():  # also MemoryError, of a length that is damaged
            self._check()
            places = ", ".join("?" for _ in keys)
            chosen = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
            for key, log_ns, data in self._database.execute(f"{chosen} ORDER BY timestamp, id", list(keys)):
                if data.startswith(_ZSTD_MAGIC):
                    self.compression = "zstd messages"
                yield key, log_ns, _decompressed(data)

    def _check(self) -> None:
        """Check tables against indexes, page by page, and that no row was deleted: they are numbered from 1 on."""
        (found,) = self._database.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise DamagedError(plain(found))
        (foreign,) = self._database.execute(
            "SELECT count(*) FROM messages WHERE typeof(id) != 'integer' OR typeof(timestamp) != 'integer' "
            "OR typeof(data) != 'blob' OR topic_id NOT IN (SELECT id FROM topics)"
        ).fetchone()
        if foreign:
            raise DamagedError(f"{foreign:,} messages are of no topic, or have no number, time or content")
        count, first, last = self._database.execute("SELECT count(*), min(id), max(id) FROM messages").fetchone()
        if count and (lost := last - min(first, 1) + 1 - count):
            raise DamagedError(
                f"{lost:,} messages are gone: the last one has number {last:,}, {count:,} are there; "
                "'ros2 bag convert' makes a bag of these"
            )

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


class Ros1File:
    """A bag file of ROS 1 that is open.

    Args:
        path: of the file.

    Raises:
        DamagedError: if rosbags cannot read it.
    """

    kind = "bag"
    compression = ""

    def __init__(self, path: Path) -> None:
        self._reader = Ros1Reader(path)
        with library_errors():
            self._reader.open()
        self.topics = {
            c.id: BagTopic(c.topic, full_type(c.msgtype), c.msgcount, _ROS1) for c in self._reader.connections
        }

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these connections in the order of log time.

        Raises:
            DamagedError: if the file cannot be read further.
        """
        wanted = [connection for connection in self._reader.connections if connection.id in keys]
        with library_errors():
            # To rosbags no connections are all of them.
            for connection, log_ns, data in self._reader.messages(wanted) if wanted else ():
                yield connection.id, log_ns, data


_BEGINNINGS: Final[dict[bytes, Callable[[Path], StorageFile]]] = {
    MCAP_MAGIC: McapFile,
    b"SQLite format 3\0": SqliteFile,
    b"#ROSBAG V2.0\n": Ros1File,
}
