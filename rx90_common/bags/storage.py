"""Storage files of bags, mcap, sqlite3 and ROS 1: read by rosbags, after what it does not check.

These are the checksum of an mcap file's summary, damaged pages of a database, and the counts of messages.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias
from urllib.parse import quote
from zlib import crc32

from backports import zstd
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from rx90_common.bags.damage import ZSTD_MAGIC, DamagedError
from rx90_common.bags.topics import JOINT_STATE
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

ACCEPTED = (
    "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, "
    "or a .csv, .parquet or .npz table"
)
MCAP_MAGIC = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\0"
_ROS1_MAGIC = b"#ROSBAG V2.0\n"
_FOOTER = struct.Struct("<QQI")  # places of summary and offsets, checksum
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


def topic_of(connection: Connection) -> BagTopic:
    """Return the topic of a connection as rosbags has it, its type as ROS 2 has it now, such as std_msgs/msg/Bool."""
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    msgtype = connection.msgtype
    if msgtype.count("/") == 1:
        msgtype = msgtype.replace("/", "/msg/")
    return BagTopic(connection.topic, msgtype, connection.msgcount, encoding)


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
            with zstd.open(path, "rb") as content, target.open("wb") as whole:
                shutil.copyfileobj(content, whole)
            with open_storage(target) as storage:
                yield storage
        return
    if beginning.startswith(MCAP_MAGIC):
        _check_mcap(path)
        reader: StorageReader = McapReader(path)
    elif beginning.startswith(_SQLITE_MAGIC):
        _check_database(path)
        reader = Sqlite3Reader(Path(quote(str(path))))  # which stands in a URI there
    elif beginning.startswith(_ROS1_MAGIC):
        reader = Ros1Reader(path)
    else:
        fault = "is no bag, or damaged at its beginning" if beginning else "is empty"
        raise BagError(f"{fault}; accepted: {ACCEPTED}")
    reader.open()
    with closing(reader):
        counted = sum(connection.msgcount for connection in reader.connections)
        stated = counted if isinstance(reader, Ros1Reader) else reader.metadata.message_count
        if counted != stated:
            raise DamagedError(f"it has {stated:,} messages, its topics {counted:,}")
        yield reader


def _check_mcap(path: Path) -> None:
    """Refuse an mcap file without its end, or with another checksum of its summary."""
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
    if verdict != "ok":
        raise DamagedError(plain(verdict))
