"""A storage file of rosbag2 in sqlite3."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path

from rx90_common.bags.files.compression import ZSTD_MAGIC, ZSTD_MESSAGES, decompress_message
from rx90_common.bags.files.contents import DamagedError, FileTopic, full_type
from rx90_common.base.quoting import plain

_FOREIGN = (
    "SELECT count(*) FROM messages WHERE typeof(id) != 'integer' OR typeof(timestamp) != 'integer' "
    "OR typeof(data) != 'blob' OR topic_id NOT IN (SELECT id FROM topics)"
)
_FAULTS = sqlite3.Error, UnicodeDecodeError, MemoryError
"""What SQLite ends with: the second for a message with bytes in it, the third for a length that is damaged."""


def _said(error: BaseException) -> str:
    return "a row asks for more memory than there is" if isinstance(error, MemoryError) else plain(error)


class SqliteFile:
    """A database that is open for reading; a journal beside it is not looked at.

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
            self.topics = self._topics()
        except (*_FAULTS, DamagedError) as error:
            self._database.close()
            raise DamagedError(_said(error)) from error

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def messages(self, keys: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield (topic, log time in ns, message) in the order of log time, equal times in that of writing.

        Raises:
            DamagedError: see `StorageFile`.
        """
        try:
            # Its tables against its indexes, page by page: a reader by time follows an index.
            (said,) = self._database.execute("PRAGMA integrity_check(1)").fetchone()
            if said != "ok":
                raise DamagedError(str(said))
            (foreign,) = self._database.execute(_FOREIGN).fetchone()
            if foreign:
                raise DamagedError(f"{foreign:,} messages are of no topic, or have no number, time or content")
            self._check_numbers()
            places = ", ".join("?" for _ in keys)
            chosen = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
            for key, log_ns, data in self._database.execute(f"{chosen} ORDER BY timestamp, id", list(keys)):
                if data.startswith(ZSTD_MAGIC):
                    self.compression = ZSTD_MESSAGES
                yield key, log_ns, decompress_message(data)
        except _FAULTS as error:
            raise DamagedError(_said(error)) from error

    def _check_numbers(self) -> None:
        """Check that no row was deleted: rosbag2 and rosbags number messages from 1, without gaps."""
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
