"""Open a bag, a folder or a file of its own; whatever is wrong with it becomes one BagError."""

from __future__ import annotations

import heapq
import re
import shutil
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from backports import zstd
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.mcap_file import MCAP_MAGIC, McapFile, cut_off
from rx90_common.bags.storage_files import (
    ZSTD_MAGIC,
    DamagedError,
    FileTopic,
    LoggedMessage,
    Ros1File,
    SqliteFile,
    full_type,
)  # fmt: skip
from rx90_common.bags.topics import JOINT_STATE, TEMPERATURE
from rx90_common.base.config import load_yaml
from rx90_common.base.errors import BagError, ConfigError, write_error
from rx90_common.base.quoting import listed, plain

ACCEPTED = "a rosbag2 folder, an .mcap, .db3 or ROS 1 .bag file, also with .zstd, or a .csv, .parquet or .npz table"


class StorageFile(Protocol):
    """A storage file that is open, or what is read like one."""

    kind: str
    compression: str
    topics: list[FileTopic]

    def close(self) -> None:
        """Close it."""

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these topics in the order of log time."""


_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_PART = re.compile(r"(.+)_([0-9]+)(\..+)", re.DOTALL)  # of a recording that was split: NAME_0.mcap, NAME_1.mcap, ...
_CDR, _ROS1 = "cdr", "ros1"
_COPY_BYTES = 1 << 20
FILE = "metadata.yaml"

EFFORT_UNIT = "rx90_emulator effort unit of "
"""Begins the key in rosbag2's custom_data that says in which unit the efforts of a topic are."""
_MOST_MESSAGES = 1 << 62


@dataclass(frozen=True)
class BagTopic:
    """A topic as a bag lists it; `encoding` is that of its messages, such as cdr."""

    name: str
    msgtype: str
    count: int
    encoding: str = _CDR

    @property
    def is_joint_state(self) -> bool:
        """Return whether its messages can be read as joint states."""
        return self.msgtype == JOINT_STATE and self.encoding in (_CDR, _ROS1)

    @property
    def holds_series(self) -> bool:
        """Return whether its messages can be read as a series: joint states or temperatures."""
        return self.msgtype in (JOINT_STATE, TEMPERATURE) and self.encoding in (_CDR, _ROS1)

    @property
    def description(self) -> str:
        """Return its type in one line, with the encoding of its messages where that is not ROS 2's."""
        kind = plain(self.msgtype) or "without a type"
        return kind if self.encoding in (_CDR, _ROS1) else f"{kind} in {plain(self.encoding) or 'no encoding'}"

    @property
    def is_ros1(self) -> bool:
        """Return whether its messages are serialised as ROS 1 does it."""
        return self.encoding == _ROS1


class BagReader:
    """A bag that is open for reading: a rosbag2 folder, an .mcap or .db3 file, a ROS 1 .bag file, or a log in columns.

    Use it as a context manager. Each storage file is held against its own index, counts and checksums, and all of them
    against metadata.yaml where there is one; a folder without is read as its files are. What it says of quality of
    service is not looked at, nor are the definitions of types that come with a bag.

    Args:
        path: the folder or file.
        mapping: what the columns of a log hold, where that is not in the file beside it.

    Attributes:
        path: as given.
        files: the storage files.
        notes: lines for the user about what was read otherwise than the bag says.
        effort_units: of topics whose efforts are not in the unit that their names say, by its metadata.

    Raises:
        BagError: if the bag is missing, foreign, damaged, or its metadata disagree with what it holds.
    """

    def __init__(self, path: Path | str, mapping: LogMapping | None = None) -> None:
        self.path = Path(path)
        self._mapping = mapping
        if not self.path.exists():
            raise BagError(f"{plain(path)}: no such bag")
        self.files: list[Path] = []
        self.notes: list[str] = []
        self.effort_units: dict[str, str] = {}
        self._storages: list[StorageFile] = []
        self._stack = ExitStack()

    def __enter__(self) -> BagReader:
        if is_table(self.path):
            from rx90_common.bags.table_file import TableFile  # pyarrow takes a while

            table = TableFile(self.path, self._mapping)
            self.files, self._storages, self.effort_units = [self.path], [table], table.effort_units
            return self
        with ExitStack() as stack:
            metadata = self._find_files()
            self._storages = [self._open(file, stack) for file in self.files]
            if metadata is not None:
                held = Counter[tuple[str, str]]()
                for topic in self.topics:
                    held[topic.name, topic.msgtype] += topic.count
                _check_counts(self.path, metadata, +held)
                self.effort_units = metadata.effort_units
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._storages = []
        self._stack.close()

    @property
    def storage(self) -> str:
        """Return the kind of its files: mcap, db3 or bag."""
        return ", ".join(sorted({storage.kind for storage in self._storages}))

    @property
    def compression(self) -> str:
        """Return what is compressed in it, such as `zstd chunks`; known when it has been read."""
        return ", ".join(sorted({storage.compression for storage in self._storages} - {""}))

    @property
    def topics(self) -> list[BagTopic]:
        """Return the bag's topics by name; one that holds two types or two encodings stands twice."""
        counts: Counter[tuple[str, str, str]] = Counter()
        for storage in self._storages:
            for topic in storage.topics:
                counts[topic.name, topic.msgtype, topic.encoding] += topic.count
        return [BagTopic(name, kind, count, encoding) for (name, kind, encoding), count in sorted(counts.items())]

    def messages(self, topics: Collection[BagTopic]) -> Iterator[tuple[BagTopic, int, bytes]]:
        """Yield (topic, log time in ns, serialised message) in the order of log time.

        Raises:
            BagError: if the bag is damaged.
        """
        wanted = {(topic.name, topic.msgtype, topic.encoding): topic for topic in topics}
        parts = [
            self._messages(file, storage, wanted) for file, storage in zip(self.files, self._storages, strict=True)
        ]
        yield from parts[0] if len(parts) == 1 else heapq.merge(*parts, key=itemgetter(1))

    def deserialize(self, topic: BagTopic, data: bytes) -> Any:
        """Return the message as rosbags builds it.

        Raises:
            BagError: if the type is none of ROS's common interfaces, or the bytes are no message of it.
        """
        store = _typestore(Stores.ROS1_NOETIC if topic.is_ros1 else Stores.ROS2_JAZZY)
        if topic.msgtype not in store.fielddefs or topic.encoding not in (_CDR, _ROS1):
            raise BagError(f"{plain(self.path)}: {plain(topic.name)} is {topic.description}, which is not known here")
        try:
            return (store.deserialize_ros1 if topic.is_ros1 else store.deserialize_cdr)(data, topic.msgtype)
        except Exception as error:  # rosbags has no error of its own for bytes that do not fit
            raise BagError(
                f"{plain(self.path)}: damaged: a message of {plain(topic.name)} is no {plain(topic.msgtype)} "
                f"({type(error).__name__})"
            ) from error

    def _find_files(self) -> _Metadata | None:
        """Find the storage files; return the metadata if there are any."""
        if not self.path.is_dir():
            if self.path.is_fifo() or self.path.is_socket():  # to open it would wait for a writer
                raise BagError(f"{plain(self.path)}: no file that can be read twice; accepted: {ACCEPTED}")
            self.files = [self.path]
            return None
        there = sorted(file for file in self.path.iterdir() if file.name.endswith(_SUFFIXES))
        if (self.path / FILE).exists():
            metadata = _read_metadata(self.path)
            self.files = [self.path / name for name in metadata.files]
            missing = [file.name for file in self.files if not file.is_file()]
            if missing:
                raise BagError(f"{plain(self.path)}: {plain(missing[0])} is missing, which {FILE} names")
            if self.files:
                return metadata
        if not there:
            raise BagError(
                f"{plain(self.path)}: not a bag, or an emptied one: no .mcap or .db3 file in it; accepted: {ACCEPTED}"
            )
        self.files = self._in_order(there)
        self.notes.append(f"{FILE} is missing; read as they are: {plain(', '.join(file.name for file in self.files))}")
        return None

    def _in_order(self, there: list[Path]) -> list[Path]:
        """Return the files of a folder without metadata: one, or the parts of one recording by their numbers."""
        if len(there) == 1:
            return there
        parts = [part for file in there if (part := _PART.fullmatch(file.name))]
        numbers = sorted(int(part[2]) for part in parts)
        same = len(parts) == len(there) and len({(part[1], part[3]) for part in parts}) == 1
        if not same or numbers != list(range(numbers[0], numbers[0] + len(there))):
            raise BagError(
                f"{plain(self.path)}: {FILE} is missing, and {listed(file.name for file in there)} are not the parts "
                "of one recording; accepted: NAME_0.mcap, NAME_1.mcap and so on without a gap, or each file by its path"
            )
        return [self.path / part[0] for part in sorted(parts, key=lambda part: int(part[2]))]

    def _open(self, file: Path, stack: ExitStack) -> StorageFile:
        try:
            return _open_storage(file, stack)
        except (DamagedError, BagError) as error:
            raise self._refusal(file, error) from error
        except OSError as error:
            raise BagError(f"{plain(file)}: cannot be read ({error.strerror})") from error

    def _messages(
        self, file: Path, storage: StorageFile, wanted: dict[tuple[str, str, str], BagTopic]
    ) -> Iterator[tuple[BagTopic, int, bytes]]:
        topics = {t.key: topic for t in storage.topics if (topic := wanted.get((t.name, t.msgtype, t.encoding)))}
        read = 0
        try:
            for key, log_ns, data in storage.messages(topics):
                read += 1
                yield topics[key], log_ns, data
        except DamagedError as error:
            raise self._refusal(file, error) from error
        listed = sum(topic.count for topic in storage.topics if topic.key in topics)
        if read != listed:
            raise self._refusal(file, DamagedError(f"{listed:,} messages should be there, {read:,} can be read"))

    def _refusal(self, file: Path, error: Exception) -> BagError:
        what = "is damaged: " if isinstance(error, DamagedError) else ""
        return BagError(f"{plain(self.path)}: {plain(file.name)} {what}{error}")


_BEGINNINGS = ((MCAP_MAGIC, McapFile), (b"SQLite format 3\0", SqliteFile), (b"#ROSBAG V2.0\n", Ros1File))


def _open_storage(path: Path, stack: ExitStack) -> StorageFile:
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
    reason = cut_off(path)
    if reason is not None:
        raise BagError(reason)
    with path.open("rb") as stream:
        beginning = stream.read(max(len(known) for known, _ in _BEGINNINGS))
    if not beginning:
        raise BagError("is empty")
    if beginning.startswith(ZSTD_MAGIC):
        target = Path(stack.enter_context(TemporaryDirectory(prefix="rx90_bag_"))) / path.stem
        _decompress_file(path, target)
        inner = _open_storage(target, stack)
        inner.compression = "zstd files"
        return inner
    for known, kind in _BEGINNINGS:
        if beginning.startswith(known):
            file: StorageFile = kind(path)
            stack.callback(file.close)
            return file
    raise BagError(f"is no bag, or damaged at its beginning; accepted: {ACCEPTED}")


def _decompress_file(source: Path, target: Path) -> None:
    with source.open("rb") as raw, zstd.open(raw, "rb") as content:
        try:
            with target.open("wb") as stream:
                shutil.copyfileobj(content, stream, _COPY_BYTES)
        except (zstd.ZstdError, EOFError) as error:
            raise DamagedError(f"{error}") from error
        except OSError as error:
            raise write_error(target, error) from error


@dataclass(frozen=True)
class _Metadata:
    """What metadata.yaml says; quality of service and times are not looked at.

    Attributes:
        files: names of the storage files, in their order.
        counts: messages by topic name and type, without those that have none.
        total: messages in all.
        effort_units: of topics whose efforts are not in the unit that their names say.
    """

    files: tuple[str, ...]
    counts: Counter[tuple[str, str]]
    total: int
    effort_units: dict[str, str]


def _read_metadata(folder: Path) -> _Metadata:
    """Read the metadata.yaml of a folder.

    Raises:
        BagError: naming folder, key, value and what is accepted.
    """
    try:
        root = load_yaml(folder / FILE, "the metadata of a rosbag2 folder").section("rosbag2_bagfile_information")
        counts: Counter[tuple[str, str]] = Counter()
        for topic in root.sections("topics_with_message_count"):
            about = topic.section("topic_metadata")
            count = topic.integer("message_count", 0, _MOST_MESSAGES)
            if count:
                counts[about.text("name"), full_type(about.text("type"))] += count
        files = tuple(PurePosixPath(file).name for file in root.texts("relative_file_paths"))
        custom = root.content.get("custom_data")
        units = {
            str(key).removeprefix(EFFORT_UNIT): plain(value)
            for key, value in (custom.items() if isinstance(custom, dict) else ())
            if str(key).startswith(EFFORT_UNIT)
        }
        return _Metadata(files, counts, root.integer("message_count", 0, _MOST_MESSAGES), units)
    except ConfigError as error:
        raise BagError(f"{plain(folder)}: {str(error).removeprefix(f'{plain(folder)}/')}") from error


def _check_counts(path: Path, metadata: _Metadata, held: Counter[tuple[str, str]]) -> None:
    """Compare the metadata with what the storage files hold.

    Raises:
        BagError: naming the first topic that differs.
    """
    remedy = "'ros2 bag reindex' writes it anew, and each storage file can be read by its own path"
    for key in sorted(metadata.counts.keys() | held.keys()):
        if metadata.counts[key] != held[key]:
            topic, msgtype = map(plain, key)
            raise BagError(
                f"{plain(path)}: {FILE} says {metadata.counts[key]} messages of {topic} ({msgtype}), "
                f"the storage holds {held[key]}; {remedy}"
            )
    if metadata.total != metadata.counts.total():
        raise BagError(
            f"{plain(path)}: {FILE} says {metadata.total} messages in all, "
            f"its topics add up to {metadata.counts.total()}; {remedy}"
        )


@cache
def _typestore(name: Stores) -> Typestore:
    return get_typestore(name)
