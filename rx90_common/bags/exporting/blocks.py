"""The series of a bag in blocks of messages, so that a long bag needs no more memory than a short one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import series_builder
from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

_BLOCK = 8192  # messages of a topic


def read_blocks(bag: BagReader, topics: Sequence[BagTopic]) -> Iterator[JointSeries]:
    """Yield the messages of JointState and Temperature topics in the order of the bag, block by block.

    All blocks of a topic have the same joints in the same order, and the same arrays.

    Raises:
        BagError: if the bag is damaged, or a topic carries several sets of joints or arrays.
    """
    names = temperature_names(bag, topics)
    collected = {topic: _Collector(bag, topic, names.get(topic, ())) for topic in topics}
    for topic, _, data in bag.messages(topics):
        collector = collected[topic]
        if collector.is_full_before(data):
            yield collector.take()
        collector.add(data)
    for collector in collected.values():
        if collector.count:
            yield collector.take()


def temperature_names(bag: BagReader, topics: Sequence[BagTopic]) -> dict[BagTopic, tuple[str, ...]]:
    """Return of what each Temperature topic tells, in the order of the first messages.

    A message holds one name, so the whole topic says which columns its table has.

    Raises:
        BagError: if the bag is damaged.
    """
    warm = [topic for topic in topics if not topic.is_joint_state]
    found: dict[BagTopic, dict[str, None]] = {topic: {} for topic in warm}
    for topic, _, data in bag.messages(warm) if warm else ():
        found[topic].setdefault(str(bag.deserialize(topic, data).header.frame_id))
    return {topic: tuple(names) for topic, names in found.items()}


class _Collector:
    """The messages of a topic that are still to be handed on."""

    def __init__(self, bag: BagReader, topic: BagTopic, names: Sequence[str]) -> None:
        self.count = 0
        self._bag, self._topic = bag, topic
        self._first: JointSeries | None = None
        self._builder = series_builder(bag, topic, names)

    def is_full_before(self, data: bytes) -> bool:
        """Return whether the block is full, and this message belongs to no row of it."""
        return self.count >= _BLOCK and self._builder.begins_row(data)

    def add(self, data: bytes) -> None:
        """Add a message."""
        self._builder.add(data)
        self.count += 1

    def take(self) -> JointSeries:
        """Return the block and begin another."""
        found = self._builder.build()
        first = self._first = self._first or found[0]
        self.count, self._builder = 0, series_builder(self._bag, self._topic, first.names)
        for other in found:
            if set(other.names) != set(first.names):
                sets = "; ".join(", ".join(map(plain, one.names)) for one in (first, other))
                raise self._refusal(f"carries several sets of joints: {sets}")
            if set(other.fields) != set(first.fields):
                sets = " and ".join(", ".join(one.fields) or "nothing" for one in (first, other))
                raise self._refusal(f"carries {sets} in different messages")
        return found[0] if found[0].names == first.names else found[0].select(first.names)

    def _refusal(self, what: str) -> BagError:
        one = "accepted for a table: the same in all messages; leave the topic out with --topic"
        return BagError(f"{plain(self._bag.path)}: {plain(self._topic.name)} {what}; {one}")
