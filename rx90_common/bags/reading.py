"""Read bags and tables: their messages, and recorded joint states as arrays; needs no ROS.

series = read_bag("bag")["joint_states"]
series.stamp_ns, series.names, series.position  # (n,), k names, (n, k)
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from pydantic import ConfigDict, Field
from rosbags.typesys import Stores, get_typestore

from rx90_common.bags.joint_messages import SeriesBuilder
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.limits import DamagedError
from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.storage import ACCEPTED, BagTopic, StorageFile, full_type, open_storage
from rx90_common.bags.topics import EFFORT_UNIT, JOINT_STATE, absolute
from rx90_common.base.errors import BagError, ConfigError, located
from rx90_common.base.models import Model, Names, read_model
from rx90_common.base.quoting import counted, listed, plain

__all__ = ["BagReader", "BagTopic", "JointSeries", "read_bag", "read_joint_states"]

Progress = Callable[[int, int], None]
"""Called with how much is done, and of how much."""
FILE = "metadata.yaml"
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class _Known(Model):
    """The part of rosbag2's metadata that is used."""

    model_config = ConfigDict(extra="ignore")


class _TopicMetadata(_Known):
    name: str
    type: str


class _TopicCount(_Known):
    topic_metadata: _TopicMetadata
    message_count: Annotated[int, Field(ge=0)]


class _Information(_Known):
    topics_with_message_count: Annotated[tuple[_TopicCount, ...], Field(strict=False)]
    relative_file_paths: Names
    custom_data: dict[str, Any] | None = None


class _Metadata(_Known):
    rosbag2_bagfile_information: _Information


_STEP = 8192  # messages between two reports of progress
_typestore = cache(get_typestore)


def silent(_done: int, _total: int) -> None:
    """Report nothing."""


class BagReader:
    """A bag that is open for reading: a rosbag2 folder, an .mcap or .db3 file, a ROS 1 .bag file, or a log in columns.

    Use it as a context manager. Each storage file is checked against its own index, counts and checksums, and all of
    them against metadata.yaml if there is one. Quality of service and the definitions of types in a bag are ignored.
    A log in columns has series and no messages.

    Args:
        path: the folder or file.
        mapping: of the columns of a log, if it is not in the file beside it.

    Attributes:
        path: as given.
        effort_units: of topics whose efforts are not in the usual unit of their names, by its metadata.
        table: the series of a log in columns.
    """

    def __init__(self, path: Path | str, mapping: LogMapping | None = None) -> None:
        self.path = Path(path)
        self._mapping = mapping
        if not self.path.exists():
            raise BagError(f"{plain(path)}: no such bag")
        self.effort_units: dict[str, str] = {}
        self.table: Sequence[JointSeries] = ()
        self._storages: dict[Path, StorageFile] = {}
        self._stack = ExitStack()

    def __enter__(self) -> BagReader:
        if is_table(self.path):
            from rx90_common.bags.logs import read_log  # pyarrow takes a while

            self.table = [read_log(self.path, self._mapping)]
            self.effort_units = {series.topic: series.effort_unit for series in self.table}
            return self
        with ExitStack() as stack:
            counts: Counter[tuple[str, str]] = Counter()
            files = self._read_metadata(counts) if (self.path / FILE).exists() else []
            for file in files or [self._storage_file()]:
                with self._damage(file):
                    self._storages[file] = stack.enter_context(open_storage(file))
            if files:
                self._compare(counts)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def storage(self) -> str:
        """Return the kind of its files: mcap, db3 or bag; of a log its suffix."""
        kinds = sorted({storage.kind for storage in self._storages.values()})
        return ", ".join(kinds) if kinds else self.path.suffix.lower().removeprefix(".")

    @property
    def topics(self) -> list[BagTopic]:
        """Return the bag's topics by name; one with two types or two encodings occurs twice."""
        counts: Counter[tuple[str, str, str]] = Counter()
        for storage in self._storages.values():
            for topic in storage.topics.values():
                counts[topic.identity] += topic.count
        topics = [BagTopic(name, kind, count, encoding) for (name, kind, encoding), count in counts.items()]
        topics += [BagTopic(series.topic, JOINT_STATE, len(series.stamp_ns)) for series in self.table]
        return sorted(topics, key=attrgetter("identity"))

    def messages(self, topics: Collection[BagTopic]) -> Iterator[tuple[BagTopic, int, bytes]]:
        """Yield (topic, log time in ns, serialised message) in the order of log time."""
        wanted = {topic.identity: topic for topic in topics}
        parts = [self._messages(file, wanted) for file in self._storages]
        yield from parts[0] if len(parts) == 1 else heapq.merge(*parts, key=itemgetter(1))

    def deserialize(self, topic: BagTopic, data: bytes) -> Any:
        """Return the message as rosbags builds it."""
        store = _typestore(Stores.ROS1_NOETIC if topic.is_ros1 else Stores.ROS2_JAZZY)
        if topic.msgtype not in store.fielddefs:
            kind = plain(topic.msgtype)
            raise BagError(f"{plain(self.path)}: {plain(topic.name)} is {kind}, which is not known here")
        try:
            return (store.deserialize_ros1 if topic.is_ros1 else store.deserialize_cdr)(data, topic.msgtype)
        except Exception as error:  # rosbags has no error of its own for bytes that do not fit
            what = f"a message of {plain(topic.name)} is no {plain(topic.msgtype)} ({type(error).__name__})"
            raise BagError(f"{plain(self.path)}: damaged: {what}") from error

    def series_topics(self, topics: Collection[str] | None = None, *, filled: bool = True) -> list[BagTopic]:
        """Return the topics with these names, or all that hold series with messages.

        Args:
            topics: names.
            filled: whether those with these names must have messages.
        """
        there = self.topics
        by_name = {topic.name: topic for topic in there if topic.is_joint_state}
        if topics is None:
            chosen = [topic for topic in by_name.values() if topic.count]
            if not chosen:
                others = listed(topic.name for topic in there) or "nothing"
                raise BagError(f"{plain(self.path)}: holds no joint states, only {others}")
            return chosen
        chosen = []
        for name in dict.fromkeys(map(absolute, topics)):
            if name not in by_name:
                kinds = [plain(topic.msgtype) for topic in there if topic.name == name]
                what = f"{plain(name)} is {kinds[0]}" if kinds else f"no topic {plain(name)}"
                raise BagError(f"{plain(self.path)}: {what}; {series_topics_text(there)}")
            if filled and not by_name[name].count:
                raise BagError(f"{plain(self.path)}: no messages in {plain(name)}")
            chosen.append(by_name[name])
        return chosen

    def joint_states(
        self, topics: Collection[BagTopic], progress: Progress = silent, *, record_time: bool = False
    ) -> JointBag:
        """Return the series of these topics of joint states."""
        names = [topic.name for topic in topics]
        if self.table:
            series = {series.topic: [series] for series in self.table if series.topic in names}
            return JointBag(self.path, self.topics, series)
        builders: dict[int, SeriesBuilder] = {}  # to hash a topic takes 0.5 us
        for topic in topics:
            unit = self.effort_units.get(topic.name, "")
            deserialize = partial(self.deserialize, topic)
            builders[id(topic)] = SeriesBuilder(topic.name, deserialize, cdr=not topic.is_ros1, effort_unit=unit)
        total = sum(topic.count for topic in topics)
        with located(plain(self.path), BagError):
            for done, (topic, log_ns, data) in enumerate(self.messages(topics), 1):
                builders[id(topic)].add(data, log_ns if record_time else None)
                if done % _STEP == 0 or done == total > _STEP:
                    progress(done, total)
            series = dict(zip(names, (builder.build() for builder in builders.values()), strict=True))
        return JointBag(self.path, self.topics, series)

    def _read_metadata(self, counts: Counter[tuple[str, str]]) -> list[Path]:
        """Return the files that metadata.yaml names; note the units of efforts, and messages by topic and type."""
        try:
            metadata = read_model(_Metadata, self.path / FILE, "the metadata of a rosbag2 folder")
        except ConfigError as error:
            raise BagError(f"{plain(self.path)}: {str(error).removeprefix(f'{plain(self.path)}/')}") from error
        information = metadata.rosbag2_bagfile_information
        for topic in information.topics_with_message_count:
            about = topic.topic_metadata
            counts[about.name, full_type(about.type)] += topic.message_count
        for key, value in (information.custom_data or {}).items():
            if key.startswith(EFFORT_UNIT):
                self.effort_units[key.removeprefix(EFFORT_UNIT)] = plain(value)
        files = [self.path / PurePosixPath(file).name for file in information.relative_file_paths]
        for file in files:
            if not file.is_file():
                raise BagError(f"{plain(self.path)}: {plain(file.name)} is missing, which {FILE} names")
        return files

    def _compare(self, counts: Counter[tuple[str, str]]) -> None:
        """Refuse a bag that does not hold the messages of its metadata."""
        held: Counter[tuple[str, str]] = Counter()
        for topic in self.topics:
            held[topic.name, topic.msgtype] += topic.count
        for name, msgtype in sorted(key for key in counts.keys() | held.keys() if counts[key] != held[key]):
            said = f"{counted(counts[name, msgtype], 'message')} of {plain(name)} ({plain(msgtype)})"
            raise BagError(
                f"{plain(self.path)}: {FILE} says {said}, the storage holds {held[name, msgtype]}; 'ros2 bag reindex' "
                "writes it anew, and each storage file can be read by its own path"
            )

    def _storage_file(self) -> Path:
        """Return the storage file where no metadata name them."""
        where = plain(self.path)
        if not self.path.is_dir():
            if not self.path.is_file():  # to open a pipe would wait for a writer
                raise BagError(f"{where}: no file that can be read twice; accepted: {ACCEPTED}")
            return self.path
        files = sorted(file for file in self.path.iterdir() if file.name.endswith(_SUFFIXES))
        if not files:
            raise BagError(f"{where}: not a bag, or an emptied one: no .mcap or .db3 file in it; accepted: {ACCEPTED}")
        if len(files) > 1:
            raise BagError(
                f"{where}: {FILE} is missing, and there are {listed(file.name for file in files)}; accepted: one file, "
                "or each by its path; 'ros2 bag reindex' writes the metadata of several"
            )
        return files[0]

    def _messages(
        self, file: Path, wanted: dict[tuple[str, str, str], BagTopic]
    ) -> Iterator[tuple[BagTopic, int, bytes]]:
        storage = self._storages[file]
        topics = {key: wanted[topic.identity] for key, topic in storage.topics.items() if topic.identity in wanted}
        with self._damage(file):
            for key, log_ns, data in storage.messages(topics):
                yield topics[key], log_ns, data

    @contextmanager
    def _damage(self, file: Path) -> Iterator[None]:
        """Prefix messages about a storage file with bag and file."""
        try:
            yield
        except DamagedError as error:
            raise BagError(f"{plain(self.path)}: {plain(file.name)} is damaged: {error}") from error
        except BagError as error:
            raise BagError(f"{plain(self.path)}: {plain(file.name)} {error}") from error
        except OSError as error:
            raise BagError(f"{plain(file)}: cannot be read ({error.strerror})") from error


@dataclass(frozen=True, eq=False)
class JointBag:
    """The content of a bag.

    Attributes:
        path: of the bag.
        topics: all topics of the bag.
        series: by absolute topic name, one for each set of joints in the topic, in the order of their first
            messages; none for a topic without messages.
    """

    path: Path
    topics: Sequence[BagTopic]
    series: dict[str, list[JointSeries]]

    @property
    def begin_ns(self) -> int:
        """Return the first stamp, ns."""
        series = chain.from_iterable(self.series.values())
        stamps = [int(part.stamp_ns.min()) for part in series if len(part.stamp_ns)]
        if not stamps:
            raise BagError(f"{plain(self.path)}: holds no JointState message, so it has no start to be aligned")
        return min(stamps)

    def one(self, topic: str, names: Sequence[str] | None = None, remedy: str = "say which joints") -> JointSeries:
        """Return the series of a topic that has these joints, in this order; by default its only one."""
        sets = self.series[topic]
        if not sets:
            raise BagError(f"{plain(self.path)}: no messages in {plain(topic)}")
        if names is not None:
            fitting = [series for series in sets if set(names) <= set(series.names)]
            with located(plain(self.path)):
                return (fitting or sets)[0].select(names)
        if len(sets) > 1:
            joints = "; ".join(", ".join(map(plain, series.names)) for series in sets)
            raise BagError(f"{plain(self.path)}: {plain(topic)} carries several sets of joints: {joints}; {remedy}")
        return sets[0]

    def moved(self, shift_ns: int) -> JointBag:
        """Return the same with stamps that much later, ns."""
        later = {
            topic: [replace(series, stamp_ns=series.stamp_ns + shift_ns) for series in sets]
            for topic, sets in self.series.items()
        }
        return replace(self, series=later)


def read_joint_bag(
    path: Path | str,
    topics: Collection[str] | None = None,
    progress: Progress = silent,
    mapping: LogMapping | None = None,
    *,
    record_time: bool = False,
    all_there: bool = False,
) -> JointBag:
    """Read JointState topics of a bag in one pass, with a list of all it holds.

    Args:
        path: as `read_joint_states`.
        topics: topic names; by default all JointState topics of the bag.
        progress: called with the numbers of messages that are read and that there are.
        mapping: as `read_joint_states`.
        record_time: as `read_joint_states`.
        all_there: whether topics that are not there are refused.
    """
    with BagReader(path, mapping) as bag:
        if topics is not None and all_there:
            wanted = bag.series_topics(topics, filled=False)
        else:
            names = None if topics is None else {*map(absolute, topics)}
            wanted = [topic for topic in bag.topics if topic.is_joint_state and (names is None or topic.name in names)]
        return bag.joint_states(wanted, progress, record_time=record_time)


def read_joint_states(
    path: Path | str,
    topic: str,
    names: Sequence[str] | None = None,
    *,
    record_time: bool = False,
    mapping: LogMapping | None = None,
) -> JointSeries:
    """Read one JointState topic of a bag.

    Args:
        path: a rosbag2 folder, an .mcap or .db3 file, a ROS 1 .bag file, or a CSV, Parquet or NPZ table.
        topic: topic name; the leading slash may be left out.
        names: requested joints, in this order; by default all, as in the first message.
        record_time: use the times at which messages were recorded as their stamps.
        mapping: of the columns of a table; by default the file beside it.

    Raises:
        BagError: if the bag cannot be read, has no such JointState topic, no messages in it, or no such
            joint; or if the topic contains several sets of joints and `names` does not select from one of them.
    """
    bag = read_joint_bag(path, [topic], mapping=mapping, record_time=record_time, all_there=True)
    return bag.one(absolute(topic), names)


def read_bag(
    path: Path | str, topics: Sequence[str] | None = None, *, record_time: bool = False
) -> dict[str, JointSeries]:
    """Read the JointState topics of a bag in one pass.

    Args:
        path: as `read_joint_states`.
        topics: topic names; by default all JointState topics of the bag that hold messages.
        record_time: as `read_joint_states`.

    Returns:
        A series by topic, without the leading slash: `joint_states`, `rx90_controller/reference`, ...

    Raises:
        BagError: if the bag cannot be read, or a topic is not there as JointState, has no messages, or
            carries several sets of joints (`read_joint_states` picks from these).
    """
    bag = read_joint_bag(path, topics, record_time=record_time, all_there=True)
    wanted = [topic for topic, series in bag.series.items() if series or topics is not None]
    return {topic.removeprefix("/"): bag.one(topic) for topic in wanted}


def series_topics_text(topics: Iterable[BagTopic]) -> str:
    """Return the names of those topics that hold series, for a message."""
    names = sorted({topic.name for topic in topics if topic.is_joint_state})
    return f"JointState topics: {listed(names) or 'none'}"
