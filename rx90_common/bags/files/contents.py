"""What every kind of storage file gives, and how it says that it is damaged."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Protocol


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


class StorageFile(Protocol):
    """A storage file that is open.

    Attributes:
        kind: mcap, db3 or bag.
        compression: of what is in it, such as `zstd chunks`; empty without.
        topics: what it holds.
    """

    kind: str
    compression: str
    topics: list[FileTopic]

    def messages(self, keys: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield (key of the topic, log time in ns, message) in the order of log time.

        Raises:
            DamagedError: if index, counts or checksums are not those of the messages.
        """

    def close(self) -> None:
        """Close the file."""


def full_type(msgtype: str) -> str:
    """Return the name of a type as ROS 2 has it now: `sensor_msgs/JointState` is `sensor_msgs/msg/JointState`."""
    package, slash, name = msgtype.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else msgtype
