"""What storage files of bags have in common, and those of sqlite3 and ROS 1; one that contradicts itself is refused."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from backports import zstd
from rosbags.rosbag1 import Reader as Ros1Reader

from rx90_common.base.quoting import plain

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""
_MOST_BYTES = 256 << 20  # of a compressed message; nothing beside it says how long it is

LoggedMessage: TypeAlias = tuple[int, int, bytes]
"""Key of the topic, log time in ns, message."""


class DamagedError(Exception):
    """A storage file contradicts itself; the text says where, for the reader of the bag to put the file before it."""


@dataclass(frozen=True)
class FileTopic:
    """A topic as a storage file lists it.

    Attributes:
        key: what the file knows it by.
        name: of the topic.
        msgtype: such as sensor_msgs/msg/JointState.
        encoding: of its messages: cdr, ros1, or whatever else.
        count: its messages.
    """

    key: int
    name: str
    msgtype: str
    encoding: str
    count: int


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
        text = " ".join(str(error).split())
        kind = type(error).__name__
        raise DamagedError(plain(f"{where}{kind}: {text}" if text else f"{where}{kind}", 300)) from error


def decompressed(content: bytes) -> bytes:
    """Return a message; one that is compressed begins as no CDR message does.

    Raises:
        DamagedError: if it cannot be decompressed.
    """
    if not content.startswith(ZSTD_MAGIC):
        return content
    frame = zstd.ZstdDecompressor()
    try:
        data = frame.decompress(content, _MOST_BYTES)
    except zstd.ZstdError as error:
        raise DamagedError(f"a compressed message: {error}") from error
    if not frame.eof:
        raise DamagedError(f"a compressed message is cut off, or longer than {_MOST_BYTES:,} bytes")
    return data


class SqliteFile:
    """A database of rosbag2 that is open for reading; a journal beside it is not looked at.

    Args:
        path: of the file.

    Raises:
        DamagedError: if it cannot be read, or is the database of something else.
    """

    kind = "db3"

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        self.compression = ""
        try:
            with self._errors():
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
        with self._errors():
            self._check()
            places = ", ".join("?" for _ in keys)
            chosen = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
            for key, log_ns, data in self._database.execute(f"{chosen} ORDER BY timestamp, id", list(keys)):
                if data.startswith(ZSTD_MAGIC):
                    self.compression = "zstd messages"
                yield key, log_ns, decompressed(data)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError, zstd.ZstdError) as error:
            raise DamagedError(plain(error)) from error

    def _check(self) -> None:
        """Check tables against indexes, page by page, and that no row was deleted: they are numbered from 1 on."""
        (said,) = self._database.execute("PRAGMA integrity_check(1)").fetchone()
        if said != "ok":
            raise DamagedError(plain(said))
        (foreign,) = self._database.execute(
            "SELECT count(*) FROM messages WHERE typeof(id) != 'integer' OR typeof(timestamp) != 'integer' "
            "OR typeof(data) != 'blob' OR topic_id NOT IN (SELECT id FROM topics)"
        ).fetchone()
        if foreign:
            raise DamagedError(f"{foreign:,} messages are of no topic, or have no number, time or content")
        count, first, last = self._database.execute("SELECT count(*), min(id), max(id) FROM messages").fetchone()
        lost = last - min(first, 1) + 1 - count if count else 0
        if lost:
            raise DamagedError(
                f"{lost:,} messages are gone: the last one has number {last:,}, {count:,} are there; "
                "'ros2 bag convert' makes a bag of these"
            )

    def _topics(self) -> list[FileTopic]:
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
        return [FileTopic(key, name, full_type(kind), form, count) for key, name, kind, form, count in rows]


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
        self.topics = [
            FileTopic(connection.id, connection.topic, full_type(connection.msgtype), "ros1", connection.msgcount)
            for connection in self._reader.connections
        ]

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these connections in the order of log time.

        Raises:
            DamagedError: if the file cannot be read further.
        """
        wanted = [connection for connection in self._reader.connections if connection.id in keys]
        if not wanted:
            return  # to rosbags no connections are all of them
        with library_errors():
            for connection, log_ns, data in self._reader.messages(wanted):
                yield connection.id, log_ns, data
