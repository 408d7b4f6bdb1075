"""Read recorded joint states and temperatures as arrays; needs no ROS.

series = read_bag("bag")["joint_states"]
series.stamp_ns, series.names, series.position  # (n,), k names, (n, k)
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rx90_common.bags.decoding import SeriesBuilder, TemperatureBuilder
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.bags.topics import absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain

__all__ = ["BagReader", "BagTopic", "JointSeries", "read_bag", "read_joint_series", "read_joint_states"]

_STEP = 8192  # messages between two reports of progress


def _silent(_done: int, _total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class JointBag:
    """What was read of a bag.

    Attributes:
        path: of the bag.
        topics: all topics that it holds.
        series: by absolute topic name, as `read_joint_series` gives them.
        notes: lines for the user about what was read otherwise than the bag says.
    """

    path: Path
    topics: Sequence[BagTopic]
    series: dict[str, list[JointSeries]]
    notes: Sequence[str]

    @property
    def begin_ns(self) -> int:
        """Return the first stamp, ns.

        Raises:
            BagError: if it holds no message of joint states or temperatures.
        """
        stamps = [int(one.stamp_ns.min()) for found in self.series.values() for one in found if len(one.stamp_ns)]
        if not stamps:
            raise BagError(
                f"{plain(self.path)}: holds no JointState or Temperature message, so it has no start to be aligned"
            )
        return min(stamps)


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
        names: joints wanted, in the order wanted; by default all, as the first message has them.
        record_time: take the times at which messages were recorded for their stamps.
        mapping: what the columns of a table hold; by default as the file beside it says.

    Raises:
        BagError: if the bag cannot be read, has no such JointState topic, no messages in it, or no such
            joint; or if the topic carries several sets of joints and `names` does not pick from one of them.
    """
    found = read_joint_series(path, [topic], record_time=record_time, mapping=mapping)[absolute(topic)]
    if not found:
        raise BagError(f"{path}: no messages in {absolute(topic)}")
    if names is not None:
        fitting = [series for series in found if set(names) <= set(series.names)]
        try:
            return (fitting or found)[0].select(names)
        except BagError as error:
            raise BagError(f"{path}: {error}") from error
    return _single(path, found)


def read_bag(
    path: Path | str, topics: Sequence[str] | None = None, *, record_time: bool = False
) -> dict[str, JointSeries]:
    """Read the JointState and Temperature topics of a bag in one pass.

    Args:
        path: as `read_joint_states`.
        topics: topic names; by default all JointState and Temperature topics of the bag that hold messages.
        record_time: as `read_joint_states`.

    Returns:
        A series by topic, without the leading slash: `joint_states`, `temperatures`, `rx90_controller/reference`, ...

    Raises:
        BagError: if the bag cannot be read, or a topic is not there as JointState or Temperature, has no messages, or
            carries several sets of joints (`read_joint_states` picks from these).
    """
    found = read_joint_series(path, topics, record_time=record_time)
    for topic, series in found.items():
        if topics is not None and not series:
            raise BagError(f"{path}: no messages in {topic}")
    return {topic.removeprefix("/"): _single(path, series) for topic, series in found.items() if series}


def _single(path: Path | str, found: Sequence[JointSeries]) -> JointSeries:
    if len(found) > 1:
        sets = "; ".join(", ".join(series.names) for series in found)
        raise BagError(f"{path}: {found[0].topic} carries several sets of joints: {sets}; say which joints")
    return found[0]


def read_joint_series(
    path: Path | str,
    topics: Sequence[str] | None = None,
    *,
    record_time: bool = False,
    mapping: LogMapping | None = None,
) -> dict[str, list[JointSeries]]:
    """Read JointState and Temperature topics of a bag in one pass.

    Args:
        path: as `read_joint_states`.
        topics: topic names; by default all JointState and Temperature topics of the bag.
        record_time: as `read_joint_states`.
        mapping: as `read_joint_states`.

    Returns:
        By absolute topic name one series for each set of joints that the topic carries, in the order of their
        first messages; an empty list for a topic without messages.

    Raises:
        BagError: if the bag cannot be read or a topic is not there as JointState or Temperature.
    """
    with BagReader(path, mapping) as bag:
        wanted = [topic for topic in bag.topics if topic.holds_series]
        if topics is not None:
            wanted = picked(Path(path), bag.topics, topics)
        return _read(bag, wanted, record_time)


def read_joint_bag(
    path: Path | str,
    topics: Collection[str] | None = None,
    progress: Callable[[int, int], None] = _silent,
    mapping: LogMapping | None = None,
) -> JointBag:
    """Read those of the topics that a bag holds, with a list of all it holds.

    Args:
        path: as `read_joint_states`.
        topics: absolute topic names; by default all JointState and Temperature topics of the bag.
        progress: called with the numbers of messages that are read and that there are.
        mapping: as `read_joint_states`.

    Raises:
        BagError: if the bag cannot be read.
    """
    with BagReader(path, mapping) as bag:
        wanted = [topic for topic in bag.topics if topic.holds_series and (topics is None or topic.name in topics)]
        series = _read(bag, wanted, record_time=False, progress=progress)
        return JointBag(Path(path), bag.topics, series, bag.notes)


def _read(
    bag: BagReader, topics: Sequence[BagTopic], record_time: bool, progress: Callable[[int, int], None] = _silent
) -> dict[str, list[JointSeries]]:
    builders = {topic: _series_builder(bag, topic) for topic in topics}
    by_identity = {id(topic): builder for topic, builder in builders.items()}  # to hash a topic takes 0.5 us
    total = sum(topic.count for topic in topics)
    try:
        for number, (topic, log_ns, data) in enumerate(bag.messages(topics), 1):
            by_identity[id(topic)].add(data, log_ns if record_time else None)
            if number % _STEP == 0:
                progress(number, total)
        if total > _STEP:
            progress(total, total)
        return {topic.name: builder.build() for topic, builder in builders.items()}
    except BagError as error:
        text, path = str(error), plain(bag.path)
        raise error if text.startswith(path) else BagError(f"{path}: {text}") from error


def _series_builder(bag: BagReader, topic: BagTopic) -> SeriesBuilder | TemperatureBuilder:
    deserialize = partial(bag.deserialize, topic)
    if topic.is_joint_state:
        unit = bag.effort_units.get(topic.name, "")
        return SeriesBuilder(topic.name, deserialize, cdr=not topic.is_ros1, effort_unit=unit)
    return TemperatureBuilder(topic.name, deserialize)


def series_topics(topics: Iterable[BagTopic]) -> str:
    """Return the names of those topics that hold series, by type, for a message."""
    series = {topic.name: topic.is_joint_state for topic in topics if topic.holds_series}
    joints, others = ([name for name in sorted(series) if series[name] is kind] for kind in (True, False))
    temperatures = f"; Temperature topics: {listed(others)}" if others else ""
    return f"JointState topics: {listed(joints) or 'none'}{temperatures}"


def picked(path: Path, there: Sequence[BagTopic], topics: Sequence[str]) -> list[BagTopic]:
    """Return those of a bag's topics that are wanted.

    Raises:
        BagError: if one is not there as JointState or Temperature, with those that are.
    """
    by_name = {topic.name: topic for topic in there if topic.holds_series}
    wanted = dict.fromkeys(map(absolute, topics))
    for name in wanted:
        if name not in by_name:
            others = [topic.description for topic in there if topic.name == name]
            what = f"{plain(name)} is {others[0]}" if others else f"no topic {plain(name)}"
            raise BagError(f"{plain(path)}: {what}; {series_topics(there)}")
    return [by_name[name] for name in wanted]


def picked_with_messages(bag: BagReader, topics: Sequence[str] | None) -> list[BagTopic]:
    """Return those of a bag's topics that are wanted, or all JointState and Temperature topics with messages.

    Raises:
        BagError: if one is not there as JointState or Temperature, or has no messages; or if there are none.
    """
    if topics is None:
        chosen = [topic for topic in bag.topics if topic.holds_series and topic.count]
        if not chosen:
            there = listed(topic.name for topic in bag.topics) or "nothing"
            raise BagError(f"{plain(bag.path)}: holds no joint states or temperatures, only {there}")
        return chosen
    chosen = picked(bag.path, bag.topics, topics)
    for topic in chosen:
        if not topic.count:
            raise BagError(f"{plain(bag.path)}: no messages in {plain(topic.name)}")
    return chosen
