"""The content of a bag, topic by topic, with gaps in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import BagReader, BagTopic
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns

_GAP = 1.5  # times the median interval between two messages


@dataclass(frozen=True)
class TopicSummary:
    """The content of a topic of a bag, by header.stamp of joint states, and by log time of other messages.

    Attributes:
        topic: topic name.
        msgtype: message type.
        count: number of messages.
        first_ns: earliest time, None without messages.
        last_ns: latest time.
        rate: messages per second between the two, None below two different times.
        gaps: intervals between messages of more than 1.5 times the median.
        longest_gap_ns: the longest of these, 0 when there is none.
        backward: messages with an earlier time than the one before.
        repeated: joint states with the same time as the one before.
        effort_unit: of a topic whose efforts are not in the usual unit of its name.
    """

    topic: str
    msgtype: str
    count: int
    first_ns: int | None
    last_ns: int | None
    rate: float | None
    gaps: int
    longest_gap_ns: int
    backward: int
    repeated: int
    effort_unit: str


@dataclass(frozen=True)
class BagSummary:
    """The content of a bag.

    Attributes:
        path: of the bag.
        topics: by name.
    """

    path: Path
    topics: tuple[TopicSummary, ...]

    @property
    def count(self) -> int:
        """Return the number of messages."""
        return sum(topic.count for topic in self.topics)


def summarise(path: Path | str, mapping: LogMapping | None = None) -> BagSummary:
    """Read a bag through and summarise it; `mapping` says what the columns of a table hold."""
    with BagReader(path, mapping) as bag:
        topics = bag.topics
        if not topics:
            raise BagError(f"{plain(bag.path)}: holds no topics")
        times: dict[BagTopic, list[int]] = {topic: [] for topic in topics}
        for topic, log_ns, data in bag.messages(topics):
            if topic.is_joint_state and topic.is_ros1:
                times[topic].append(message_time_ns(bag.deserialize(topic, data).header.stamp))
            else:
                times[topic].append(max(0, cdr_stamp_ns(data)) if topic.is_joint_state else log_ns)
        for series in bag.table:
            times[topics[0]] = series.stamp_ns.tolist()
        return BagSummary(
            path=bag.path,
            topics=tuple(
                _summarise(t, np.array(times[t], np.int64), bag.effort_units.get(t.name, ""))
                for t in topics
            ),
        )


def _summarise(topic: BagTopic, times: NDArray[np.int64], effort_unit: str) -> TopicSummary:
    steps = np.diff(times)
    forward = steps[steps > 0]
    gaps = forward[forward > _GAP * np.median(forward)] if len(forward) else forward
    span = int(np.ptp(times)) if len(times) else 0
    return TopicSummary(
        topic=topic.name,
        msgtype=topic.msgtype,
        count=topic.count,
        first_ns=int(times.min()) if len(times) else None,
        last_ns=int(times.max()) if len(times) else None,
        rate=(len(np.unique(times)) - 1) * NANOSECONDS / span if span else None,
        gaps=len(gaps),
        longest_gap_ns=int(gaps.max(initial=0)),
        backward=int((steps < 0).sum()),
        repeated=int((steps == 0).sum()) if topic.is_joint_state else 0,
        effort_unit=effort_unit,
    )
