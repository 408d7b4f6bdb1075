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
    collected = {topic: _Collector(bag, topic) for topic in topics}
    for topic, _, data in bag.messages(topics):
        collector = collected[topic]
        if collector.add(data):
            yield collector.take()
    for collector in collected.values():
        if collector.count:
            yield collector.take()


class _Collector:
    """The messages of a topic that are still to be handed on."""

    def __init__(self, bag: BagReader, topic: BagTopic) -> None:
        self.count = 0
        self._bag, self._topic = bag, topic
        self._first: JointSeries | None = None
        self._builder = series_builder(bag, topic)

    def add(self, data: bytes) -> bool:
        """Add a message; return whether the block is full."""
        self._builder.add(data)
        self.count += 1
        # A name that has no messages any more leaves all rows incomplete: one of them is then cut in two.
        return self.count >= _BLOCK and (self._builder.whole or self.count >= 2 * _BLOCK)

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
