"""The trajectories that a bag says a controller followed; needs no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.bags.topics import JOINT_TRAJECTORY
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.topics import TRAJECTORY_ACCEPTED


@dataclass(frozen=True)
class RecordedTrajectory:
    """A trajectory that a controller took.

    Attributes:
        start_ns: when it starts.
        message: the JointTrajectory; without points the arm was to stop.
    """

    start_ns: int
    message: Any


def read_trajectories(path: Path | str) -> list[RecordedTrajectory]:
    """Return the trajectories of a bag in the order of their start.

    They are those of the controller's topic `trajectory_accepted`, whose stamps are start times.

    Raises:
        BagError: if the bag cannot be read, has no such topic, or two controllers' ones.
    """
    with BagReader(path) as bag:
        topic = _topic(path, bag.topics)
        found = [bag.deserialize(topic, data) for _, _, data in bag.messages([topic])]
    trajectories = [RecordedTrajectory(message_time_ns(m.header.stamp), m) for m in found]
    return sorted(trajectories, key=lambda one: one.start_ns)


def _topic(path: Path | str, topics: Sequence[BagTopic]) -> BagTopic:
    kind = [topic for topic in topics if topic.msgtype == JOINT_TRAJECTORY]
    fitting = [topic for topic in kind if topic.name.rpartition("/")[2] == TRAJECTORY_ACCEPTED]
    if len(fitting) > 1:
        names = listed(sorted(topic.name for topic in fitting))
        raise BagError(f"{plain(path)}: has the trajectories of several controllers, {names}; accepted: those of one")
    if not fitting or not fitting[0].count:
        raise BagError(
            f"{plain(path)}: no trajectory in it; accepted: a bag with rx90_controller/{TRAJECTORY_ACCEPTED}, which "
            "rx90_bag record and rx90_run write"
        )
    return fitting[0]
