"""Storage files of bags, mcap, sqlite3 and ROS 1: read by rosbags, after what it does not check.

These are the checksum of an mcap file's summary, what chunks unpack to, damaged pages of a database, and
the counts of messages.
"""

from __future__ import annotations

import os
import sqlite3
import struct
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
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
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1.reader import Header, RecordType
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
)
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

ACCEPTED: Final = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, "
    "or a .csv, .parquet or .npz table"
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
_LONGEST = "SELECT max(length(data)) FROM messages"
StorageReader: TypeAlias = McapReader | Sqlite3Reader | Ros1Reader


@dataclass(frozen=True, order=True)
class BagTopic:
    """A topic as a bag lists it; `encoding` is that of its messages: cdr, or ros1, or another one.

    Topics are equal whose messages are of one kind, whatever the `count` of a file.
    """

    name: str
    msgtype: str
    count: int = field(compare=False)
    encoding: str = "cdr"

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


def topic_of(connection: Connection) -> BagTopic:
    """Return the topic of a connection as rosbags has it."""
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    return BagTopic(connection.topic, full_type(connection.msgtype), connection.msgcount, encoding)


@contextmanager
def open_storage(path: Path) -> Iterator[StorageReader]:
    """Open a storage file of the kind that its first bytes show; a compressed one is decompressed to a temporary file.

    Raises:
        DamagedError: if it contradicts itself; the libraries' own errors are the caller's.
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
    if beginning.startswith(MCAP_MAGIC):
        reader: StorageReader = _open_mcap(path)
    elif beginning.startswith(_SQLITE_MAGIC):
        _check_database(path)
        reader = Sqlite3Reader(Path(quote(str(path))))  # which stands in a URI there
        reader.open()
        _check_total(reader)
    elif beginning.startswith(_ROS1_MAGIC):
        reader = Ros1Reader(path)
        reader.open()
        with path.open("rb") as stream:
            _check_chunks(path, _ros1_chunks(reader, stream))
    else:
        fault = "is no bag, or damaged at its beginning" if beginning else "is empty"
        raise BagError(f"{fault}; accepted: {ACCEPTED}")
    with closing(reader):
        yield reader


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
                raise DamagedError(
                    f"the chunk at byte {start} unpacks to another length than {size:,} bytes"
                )
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
        (
            chunk.chunk_start_offset,
            chunk.compression,
            chunk.compressed_size,
            chunk.uncompressed_size,
        )
        for chunk in reader.chunks
    }
    if not indexed <= forms:
        raise DamagedError("its index leads to no chunk")
    _check_total(reader)
    return reader


def _check_total(reader: McapReader | Sqlite3Reader) -> None:
    counted = sum(connection.msgcount for connection in reader.connections)
    if counted != reader.metadata.message_count:
        raise DamagedError(
            f"it has {reader.metadata.message_count:,} messages, its topics {counted:,}"
        )


def _mcap_chunks(stream: BinaryIO) -> Iterator[_PackedChunk]:
    stream.seek(len(MCAP_MAGIC))
    while len(head := stream.read(_RECORD.size)) == _RECORD.size:
        code, length = _RECORD.unpack(head)
        begin = stream.tell()
        if code == Opcode.CHUNK:
            check_length("a chunk", length, _MAX_CHUNK_BYTES)
            chunk = Chunk.read(ReadDataStream(stream))
            yield _PackedChunk(
                begin - _RECORD.size, chunk.compression, chunk.uncompressed_size, chunk.data
            )
        stream.seek(begin + length)


def _ros1_chunks(reader: Ros1Reader, stream: BinaryIO) -> Iterator[_PackedChunk]:
    for start, chunk in reader.chunks.items():
        stream.seek(start)
        header = Header.read(stream, RecordType.CHUNK)
        stream.seek(chunk.datapos)
        content = stream.read(min(chunk.datasize, _MAX_CHUNK_BYTES + 1))
        yield _PackedChunk(
            start, header.get_string("compression"), header.get_uint32("size"), content
        )


def _check_database(path: Path) -> None:
    """Refuse a database that was not closed, or whose pages are damaged."""
    for suffix in ("-journal", "-wal"):  # reading a database with one alone would show a torn state
        with suppress(OSError):  # there is none, or its name would be too long to be one
            if Path(f"{path}{suffix}").stat().st_size:
                raise BagError(
                    f"was not closed (its recorder was killed?); sqlite3 restores {path.name} up to its last commit "
                    "when it is opened for writing, and 'ros2 bag reindex' then writes the metadata"
                )
    with closing(
        sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    ) as database:
        (verdict,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        (longest,) = database.execute(_LONGEST).fetchone()
    if verdict != "ok":
        raise DamagedError(plain(verdict))
    check_length("a message", longest or 0, MAX_MESSAGE_BYTES)
