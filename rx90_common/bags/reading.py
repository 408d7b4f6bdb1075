"""Read bags and tables: their messages, and recorded joint states as arrays; needs no ROS.

series = read_bag("bag")["joint_states"]
series.stamp_ns, series.names, series.position  # (n,), k names, (n, k)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any

from backports import zstd
from rosbags.typesys import Stores

from rx90_common.bags.damage import ZSTD_MAGIC, DamagedError, library_errors
from rx90_common.bags.joint_messages import SeriesBuilder
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.storage import ACCEPTED, BagTopic, StorageReader, open_storage, topic_of
from rx90_common.bags.topics import EFFORT_UNIT, JOINT_STATE, absolute
from rx90_common.base.config import read_yaml
from rx90_common.base.errors import BagError, ConfigError, located
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.exchange.message_types import typestore

__all__ = ["BagReader", "BagTopic", "JointSeries", "read_bag", "read_joint_states"]

Progress = Callable[[int, int], None]
"""Called with how much is done, and of how much."""
FILE = "metadata.yaml"
_STEP = 8192  # messages between two reports of progress


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
        self._readers: dict[Path, StorageReader] = {}
        self._stated: int | None = None
        self._stack = ExitStack()

    def __enter__(self) -> BagReader:
        if is_table(self.path):
            from rx90_common.bags.logs import read_log  # pyarrow takes a while

            self.table = read_log(self.path, self._mapping)
            self.effort_units = {series.topic: series.effort_unit for series in self.table}
        with ExitStack() as stack:
            stack.enter_context(located(plain(self.path), BagError))
            for file in () if self.table else self._storage_files():
                with self._damage(file):
                    self._readers[file] = stack.enter_context(open_storage(file))
            held = sum(topic.count for topic in self.topics)
            if self._stated is not None and held != self._stated:
                raise BagError(
                    f"{FILE} says {quoted(self._stated)} messages, the storage holds {held}; "
                    "'ros2 bag reindex' writes it anew, and each storage file can be read by its own path"
                )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    @property
    def topics(self) -> list[BagTopic]:
        """Return the bag's topics by name; one with two types or two encodings occurs twice."""
        counts: Counter[BagTopic] = Counter()
        for reader in self._readers.values():
            for topic in map(topic_of, reader.connections):
                counts[topic] += topic.count
        topics = [replace(topic, count=count) for topic, count in counts.items()]
        topics += [
            BagTopic(series.topic, JOINT_STATE, len(series.stamp_ns)) for series in self.table
        ]
        return sorted(topics)

    def messages(self, topics: Collection[BagTopic]) -> Iterator[tuple[BagTopic, int, bytes]]:
        """Yield (topic, log time in ns, serialised message), file by file, in each in the order of log time."""
        for file, reader in self._readers.items():
            connections = [
                connection for connection in reader.connections if topic_of(connection) in topics
            ]
            by_id = {connection.id: topic_of(connection) for connection in connections}
            read = 0
            with self._damage(file):
                # To rosbags no connections are all of them.
                for connection, log_ns, data in reader.messages(connections) if connections else ():
                    read += 1
                    message = zstd.decompress(data) if data.startswith(ZSTD_MAGIC) else data
                    yield by_id[connection.id], log_ns, message
                expected = sum(connection.msgcount for connection in connections)
                if read != expected:
                    raise DamagedError(
                        f"{expected:,} messages should be there, {read:,} can be read"
                    )

    def deserialize(self, topic: BagTopic, data: bytes) -> Any:
        """Return the message as rosbags builds it."""
        store = typestore(Stores.ROS1_NOETIC if topic.is_ros1 else Stores.ROS2_JAZZY)
        if topic.msgtype not in store.fielddefs:
            raise BagError(
                f"{plain(topic.name)} is {plain(topic.msgtype)}, which is not known here"
            )
        deserialize = store.deserialize_ros1 if topic.is_ros1 else store.deserialize_cdr
        try:
            return deserialize(data, topic.msgtype)
        except Exception as error:  # rosbags has no error of its own for bytes that do not fit
            fault = f"a message of {plain(topic.name)} is no {plain(topic.msgtype)}"
            raise BagError(f"damaged: {fault} ({type(error).__name__})") from error

    def _storage_files(self) -> list[Path]:
        """Return the path itself, or the files that metadata.yaml names; note what else that says."""
        if self.path.is_file():
            return [self.path]
        metadata = self.path / FILE
        if not metadata.exists():  # to open a pipe would wait for a writer
            raise BagError(
                f"no bag, or without {FILE}, which 'ros2 bag reindex' writes; accepted: {ACCEPTED}"
            )
        try:
            content = read_yaml(metadata)
        except ConfigError as error:
            raise BagError(str(error).removeprefix(f"{plain(self.path)}/")) from error
        with self._damage(metadata):
            information = content["rosbag2_bagfile_information"]
            self._stated = information["message_count"]
            for key, value in (information.get("custom_data") or {}).items():
                if key.startswith(EFFORT_UNIT):
                    self.effort_units[key.removeprefix(EFFORT_UNIT)] = plain(value)
            files = [
                self.path / PurePosixPath(file).name for file in information["relative_file_paths"]
            ]
        for file in files:
            if not file.is_file():
                raise BagError(f"{plain(file.name)} is missing, which {FILE} names")
        return files

    @contextmanager
    def _damage(self, file: Path) -> Iterator[None]:
        """Let messages about a storage file begin with its name."""
        try:
            with library_errors():
                yield
        except BagError as error:
            raise BagError(f"{plain(file.name)} {error}") from error


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
    def parts(self) -> list[JointSeries]:
        """Return the series of all topics."""
        return [*chain.from_iterable(self.series.values())]

    @property
    def begin_ns(self) -> int:
        """Return the first stamp, ns."""
        stamps = [int(part.stamp_ns.min()) for part in self.parts if len(part.stamp_ns)]
        if not stamps:
            raise BagError(
                f"{plain(self.path)}: holds no JointState message, so it has no start to be aligned"
            )
        return min(stamps)

    def one(self, topic: str, names: Sequence[str] | None = None) -> JointSeries:
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
            raise BagError(
                f"{plain(self.path)}: {plain(topic)} carries several sets of joints: {joints}; accepted: one"
            )
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
        by_name = {topic.name: topic for topic in bag.topics if topic.is_joint_state}
        if all_there and topics is None and not any(topic.count for topic in by_name.values()):
            raise BagError(
                f"holds no joint states, only {listed(topic.name for topic in bag.topics) or 'nothing'}"
            )
        wanted = []
        for name in by_name if topics is None else dict.fromkeys(map(absolute, topics)):
            if name in by_name:
                wanted.append(by_name[name])
            elif all_there:
                kinds = [plain(topic.msgtype) for topic in bag.topics if topic.name == name]
                fault = f"{plain(name)} is {kinds[0]}" if kinds else f"no topic {plain(name)}"
                raise BagError(f"{fault}; JointState topics: {listed(by_name) or 'none'}")
        builders = {
            topic: SeriesBuilder(topic, bag.effort_units, partial(bag.deserialize, topic))
            for topic in wanted
        }
        total = sum(topic.count for topic in wanted)
        for done, (topic, log_ns, data) in enumerate(bag.messages(wanted), 1):
            builders[topic].add(data, log_ns if record_time else None)
            if done % _STEP == 0 or done == total > _STEP:
                progress(done, total)
        series = {topic.name: builder.build() for topic, builder in builders.items()}
        series |= {part.topic: [part] for part in bag.table if part.topic in series}
        return JointBag(bag.path, bag.topics, series)


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
