"""Open any bag that rosbags can read; whatever is wrong with it becomes one BagError."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2.reader import DirectoryReader, Reader
from rosbags.typesys import Stores, get_typestore

from rx90_common.bags.damage import explain, unfinished
from rx90_common.base.errors import BagError


@dataclass(frozen=True)
class BagTopic:
    """A topic as a bag lists it."""

    name: str
    msgtype: str
    count: int


class BagReader:
    """A bag that is open for reading: a rosbag2 folder, an .mcap or .db3 file, or a ROS 1 .bag file.

    Use it as a context manager. rosbags meets damaged files with many kinds of exceptions (its own,
    struct.error, apsw errors, KeyError, ...); each leaves this class as a BagError of one line.

    Args:
        path: the folder or file.

    Raises:
        BagError: if the bag is missing, foreign, damaged, or its metadata disagree with what it holds.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise BagError(f"{self.path}: no such bag")
        self._reader: AnyReader | None = None

    def __enter__(self) -> BagReader:
        reason = unfinished(self.path)
        if reason is not None:
            raise BagError(reason)
        try:
            reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            reader.open()
        except Exception as error:
            raise BagError(explain(self.path, error)) from error
        self._reader = reader
        try:
            self._check_metadata()
        except BagError:
            reader.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    @property
    def is_ros1(self) -> bool:
        """Return whether the messages are serialised as ROS 1 does it, not as CDR."""
        return not self._open.is2

    @property
    def topics(self) -> list[BagTopic]:
        """Return the bag's topics by name; one that holds two types stands twice."""
        counts: Counter[tuple[str, str]] = Counter()
        for connection in self._open.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
        return [BagTopic(name, msgtype, count) for (name, msgtype), count in sorted(counts.items())]

    def messages(self, topics: Collection[BagTopic]) -> Iterator[tuple[BagTopic, int, bytes]]:
        """Yield (topic, log time in ns, serialised message) in the order of log time.

        Raises:
            BagError: if the bag is damaged, or does not hold as many messages as it lists.
        """
        wanted = {(topic.name, topic.msgtype): topic for topic in topics}
        connections = [c for c in self._open.connections if (c.topic, c.msgtype) in wanted]
        if not connections:
            return
        read: Counter[BagTopic] = Counter()
        try:
            for connection, log_ns, data in self._open.messages(connections):
                topic = wanted[connection.topic, connection.msgtype]
                read[topic] += 1
                yield topic, log_ns, data
        except Exception as error:
            raise BagError(explain(self.path, error)) from error
        for topic in wanted.values():
            if read[topic] != topic.count:
                raise BagError(
                    f"{self.path}: damaged: {topic.name} should hold {topic.count} messages, {read[topic]} can be read"
                )

    def deserialize(self, topic: BagTopic, data: bytes) -> Any:
        """Return the message as rosbags builds it.

        Raises:
            BagError: if the bytes are no message of the topic's type.
        """
        try:
            return self._open.deserialize(data, topic.msgtype)
        except Exception as error:
            raise BagError(
                f"{self.path}: damaged: a message of {topic.name} is no {topic.msgtype} ({type(error).__name__})"
            ) from error

    @property
    def _open(self) -> AnyReader:
        if self._reader is None:
            raise BagError(f"{self.path}: not open")
        return self._reader

    def _check_metadata(self) -> None:
        """Compare the counts in metadata.yaml with those in the storage files."""
        for reader in self._open.readers:
            if not isinstance(reader, Reader) or not isinstance(reader.storage, DirectoryReader):
                continue
            listed = _counts(reader.connections)
            held = _counts(c for storage in reader.storage.storages for c in storage.connections)
            for key in sorted(listed.keys() | held.keys()):
                if listed[key] != held[key]:
                    topic, msgtype = key
                    raise BagError(
                        f"{self.path}: metadata.yaml says {listed[key]} messages of {topic} ({msgtype}), "
                        f"the storage holds {held[key]}; 'ros2 bag reindex' writes it anew"
                    )
            if reader.message_count != listed.total():
                raise BagError(
                    f"{self.path}: metadata.yaml says {reader.message_count} messages in all, "
                    f"its topics add up to {listed.total()}; 'ros2 bag reindex' writes it anew"
                )


def _counts(connections: Any) -> Counter[tuple[str, str]]:
    counts: Counter[tuple[str, str]] = Counter()
    for connection in connections:
        if connection.msgcount:
            counts[connection.topic, connection.msgtype] += connection.msgcount
    return counts
