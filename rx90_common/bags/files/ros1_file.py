"""A bag file of ROS 1, read by rosbags."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from rosbags.rosbag1 import Reader

from rx90_common.bags.files.contents import DamagedError, FileTopic, full_type
from rx90_common.base.quoting import plain


class Ros1File:
    """A bag file of ROS 1 that is open.

    Args:
        path: of the file.

    Raises:
        DamagedError: if rosbags cannot read it, with whichever of its many exceptions.
    """

    kind = "bag"
    compression = ""

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        try:
            self._reader.open()
        except Exception as error:
            raise _damaged(error) from error
        self.topics = [
            FileTopic(connection.id, connection.topic, full_type(connection.msgtype), "ros1", connection.msgcount)
            for connection in self._reader.connections
        ]

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def messages(self, keys: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield (connection, log time in ns, message) in the order of log time.

        Raises:
            DamagedError: if the file cannot be read further.
        """
        wanted = [connection for connection in self._reader.connections if connection.id in keys]
        if not wanted:
            return  # to rosbags no connections are all of them
        try:
            for connection, log_ns, data in self._reader.messages(wanted):
                yield connection.id, log_ns, data
        except Exception as error:
            raise _damaged(error) from error


def _damaged(error: Exception) -> DamagedError:
    text = " ".join(str(error).split())
    return DamagedError(plain(f"{type(error).__name__}: {text}" if text else type(error).__name__, 300))
