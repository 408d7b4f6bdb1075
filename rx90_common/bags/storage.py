"""Storage files of bags, mcap, sqlite3 and ROS 1: read by rosbags, after what it does not check.

These are the checksum of an mcap file's summary, what chunks unpack to, deleted rows and damaged pages of a database,
and the counts of messages.
"""

from __future__ import annotations

import os
import sqlite3
import struct
from bz2 import BZ2Decompressor
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Final, NamedTuple, TypeAlias
from urllib.parse import quote
from zlib import crc32

import lz4.frame
from backports import zstd
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1.reader import Header, ReaderError, RecordType
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from rx90_common.bags.limits import (
    MAX_MESSAGE_BYTES,
    ZSTD_MAGIC,
    DamagedError,
    check_length,
    check_whole,
    library_errors,
    unpack_file,
    unpack_message,
)
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

ACCEPTED: Final = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, or a .csv, .parquet or .npz table"
)
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\0"
_ROS1_MAGIC = b"#ROSBAG V2.0\n"
_MAX_CHUNK_BYTES = 32 << 20
_RECORD = struct.Struct("<BQ")  # of mcap: op code and length
_FOOTER = struct.Struct("<QQI")  # places of summary and offsets, checksum
_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": BZ2Decompressor,
}
_UNPACKED = ("", "none")
_ROWS = "SELECT count(*), min(id), max(id), max(length(data)) FROM messages"
_Reader: TypeAlias = McapReader | Sqlite3Reader | Ros1Reader


@dataclass(frozen=True)
class BagTopic:
    """A topic as a bag lists it; `encoding` is that of its messages: cdr, or ros1, or another one."""

    name: str
    msgtype: str
    count: int
    encoding: str = "cdr"

    @property
    def identity(self) -> tuple[str, str, str]:
        """Return the properties that a topic must have in all files of a bag."""
        return self.name, self.msgtype, self.encoding

    @property
    def is_ros1(self) -> bool:
        """Return whether its messages are serialised as ROS 1 does it."""
        return self.encoding == "ros1"

    @property
    def is_joint_state(self) -> bool:
        """Return whether its messages can be read as joint states."""
        return self.msgtype == JOINT_STATE and self.encoding in ("cdr", "ros1")


def full_type(msgtype: str) -> str:
    """Return the name of a type as ROS 2 has it now: `sensor_msgs/JointState` is `sensor_msgs/msg/JointState`."""
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype


class StorageFile:
    """A storage file that is open.

    Attributes:
        kind: mcap, db3 or bag.
        topics: by its own identifiers.
    """

    def __init__(self, kind: str, reader: _Reader) -> None:
        self.kind = kind
        self._reader = reader
        self.topics: dict[int, BagTopic] = {}
        for connection in reader.connections:
            form = connection.ext
            encoding = form.serialization_format if isinstance(form, ConnectionExtRosbag2) else "ros1"
            msgtype = full_type(connection.msgtype)
            self.topics[connection.id] = BagTopic(connection.topic, msgtype, connection.msgcount, encoding)

    def messages(self, keys: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield key of the topic, log time in ns and message, for these topics, in the order of log time.

        Raises:
            DamagedError: if they do not fit the checksums, tables and indexes of the file.
        """
        connections = [connection for connection in self._reader.connections if connection.id in keys]
        read = 0
        with library_errors():
            # To rosbags no connections are all of them.
            for connection, log_ns, data in self._reader.messages(connections) if connections else ():
                read += 1
                yield connection.id, log_ns, unpack_message(data) if data.startswith(ZSTD_MAGIC) else data
        expected = sum(connection.msgcount for connection in connections)
        if read != expected:
            raise DamagedError(f"{expected:,} messages should be there, {read:,} can be read")


@contextmanager
def open_storage(path: Path) -> Iterator[StorageFile]:
    """Open a storage file of the kind that its first bytes show; a compressed one is decompressed to a temporary file.

    Raises:
        DamagedError: if it contradicts itself.
    """
    with path.open("rb") as stream:
        beginning = stream.read(16)
    if beginning.startswith(ZSTD_MAGIC):
        with TemporaryDirectory(prefix="rx90_bag_") as folder:
            target = Path(folder) / path.stem
            unpack_file(path, target)
            with open_storage(target) as storage:
                yield storage
        return
    with library_errors():
        if beginning.startswith(MCAP_MAGIC):
            kind = "mcap"
            reader: _Reader = _open_mcap(path)
        elif beginning.startswith(_SQLITE_MAGIC):
            kind = "db3"
            _check_database(path)
            reader = Sqlite3Reader(Path(quote(str(path))))  # which stands in a URI there
            reader.open()
            _check_total(reader)
        elif beginning.startswith(_ROS1_MAGIC):
            kind = "bag"
            with path.open("rb") as stream:
                _check_chunks(path, _ros1_chunks(stream))
            reader = Ros1Reader(path)
            reader.open()
        else:
            fault = "is no bag, or damaged at its beginning" if beginning else "is empty"
            raise BagError(f"{fault}; accepted: {ACCEPTED}")
    with closing(reader):
        yield StorageFile(kind, reader)


class _PackedChunk(NamedTuple):
    """Messages that are compressed together: where they begin in the file, and the length that they are to have."""

    start: int
    compression: str
    size: int
    content: bytes


def _check_chunks(path: Path, chunks: Iterator[_PackedChunk]) -> set[tuple[int, str, int, int]]:
    """Refuse chunks that unpack to too much, or to other lengths than their heads say; return place and form of each.

    rosbags unpacks a chunk whole, whatever comes of it.
    """
    whole = 0
    forms = set()
    for start, compression, size, content in chunks:
        with library_errors(f"the chunk at byte {start}: "):
            check_length(f"the chunk at byte {start}", max(size, len(content)), _MAX_CHUNK_BYTES)
            unpacked = content
            left_over = b""
            if compression not in _UNPACKED:
                decompressor = _DECOMPRESSORS[compression]()
                unpacked = decompressor.decompress(content, size + 1)
                left_over = decompressor.unused_data
            if len(unpacked) != size or left_over:
                raise DamagedError(f"the chunk at byte {start} unpacks to another length than {size:,} bytes")
        whole += size
        check_whole(path, "chunks", whole)
        forms.add((start, compression, len(content), size))
    return forms


def _open_mcap(path: Path) -> McapReader:
    """Open an mcap file that has its end, the checksum of its summary, and chunks where its index says."""
    with path.open("rb") as stream:
        end = stream.seek(-len(MCAP_MAGIC), os.SEEK_END)
        if not end or stream.read() != MCAP_MAGIC:
            raise BagError(
                "is cut off (its recorder was killed, or the disk was full?); 'mcap recover' restores what is whole"
            )
        stream.seek(end - _FOOTER.size)
        start, _, crc = _FOOTER.unpack(stream.read(_FOOTER.size))
        stream.seek(start)
        if start and crc and crc32(stream.read(max(0, end - start - 4))) != crc:
            raise DamagedError("the checksum of its summary does not match")
        forms = _check_chunks(path, _mcap_chunks(stream))
    reader = McapReader(path)
    reader.open()
    indexed = {
        (chunk.chunk_start_offset, chunk.compression, chunk.compressed_size, chunk.uncompressed_size)
        for chunk in reader.chunks
    }
    if not indexed <= forms:
        raise DamagedError("its index leads to no chunk")
    _check_total(reader)
    return reader


def _check_total(reader: McapReader | Sqlite3Reader) -> None:
    counted = sum(connection.msgcount for connection in reader.connections)
    if counted != reader.metadata.message_count:
        raise DamagedError(f"it has {reader.metadata.message_count:,} messages, its topics {counted:,}")


def _mcap_chunks(stream: BinaryIO) -> Iterator[_PackedChunk]:
    stream.seek(len(MCAP_MAGIC))
    while len(head := stream.read(_RECORD.size)) == _RECORD.size:
        code, length = _RECORD.unpack(head)
        begin = stream.tell()
        if code == Opcode.CHUNK:
            check_length("a chunk", length, _MAX_CHUNK_BYTES)
            chunk = Chunk.read(ReadDataStream(stream))
            yield _PackedChunk(begin - _RECORD.size, chunk.compression, chunk.uncompressed_size, chunk.data)
        stream.seek(begin + length)


def _ros1_chunks(stream: BinaryIO) -> Iterator[_PackedChunk]:
    """Yield the chunks of a bag of ROS 1; what stands beside them, and a cut off end, are left to rosbags."""
    stream.seek(len(_ROS1_MAGIC))
    with suppress(ReaderError):
        while True:
            header = Header.read(stream)
            length = int.from_bytes(stream.read(4), "little")
            begin = stream.tell()
            if header.get_uint8("op") == RecordType.CHUNK:
                content = stream.read(min(length, _MAX_CHUNK_BYTES + 1))
                yield _PackedChunk(begin, header.get_string("compression"), header.get_uint32("size"), content)
            stream.seek(begin + length)


def _check_database(path: Path) -> None:
    """Refuse a database that was not closed, whose pages are damaged, or from which rows were deleted."""
    for suffix in ("-journal", "-wal"):  # reading a database with one alone would show a torn state
        with suppress(OSError):  # there is none, or its name would be too long to be one
            if Path(f"{path}{suffix}").stat().st_size:
                raise BagError(
                    f"was not closed (its recorder was killed?); sqlite3 restores {path.name} up to its last commit "
                    "when it is opened for writing, and 'ros2 bag reindex' then writes the metadata"
                )
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        (verdict,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        count, first, last, longest = database.execute(_ROWS).fetchone()
    if verdict != "ok":
        raise DamagedError(plain(verdict))
    check_length("a message", longest or 0, MAX_MESSAGE_BYTES)
    if count and (lost := last - min(first, 1) + 1 - count):  # rows are numbered from 1 on
        raise DamagedError(
            f"{lost:,} messages are gone: the last one has number {last:,}, {count:,} are there; "
            "'ros2 bag convert' makes a bag of these"
        )
