"""The trajectories that a bag says a controller followed; needs no ROS."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.bags.topics import JOINT_TRAJECTORY, POINT_FIELDS
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.stamps import message_time_ns
from rx90_common.exchange.topics import COMMANDED_TRAJECTORY, OF_ACTION, TRAJECTORY_ACCEPTED


class TrajectoryCount:
    """Holds the trajectories that controllers accepted against those that came on their topics.

    Who sends one trajectory and ends may never have learned of a recorder that listens as well; the controller has got
    it, keeps it for all who listen, and is asked here.
    """

    def __init__(self) -> None:
        self._came: dict[str, Counter[bytes]] = {}
        self._accepted: dict[str, Counter[bytes]] = {}

    def add(self, topic: str, message: Any) -> None:
        """Count a JointTrajectory of any topic."""
        controller, _, name = topic.rpartition("/")
        if name == COMMANDED_TRAJECTORY:
            self._came.setdefault(controller, Counter())[_digest(message)] += 1
        elif name == TRAJECTORY_ACCEPTED and message.header.frame_id != OF_ACTION:
            self._accepted.setdefault(controller, Counter())[_digest(message)] += 1

    def missing(self, topics: Collection[str]) -> dict[str, int]:
        """Return how many trajectories did not come, by the topic that they were sent on, of those that are given."""
        none = Counter[bytes]()
        counts = {
            f"{controller}/{COMMANDED_TRAJECTORY}": (accepted - self._came.get(controller, none)).total()
            for controller, accepted in self._accepted.items()
        }
        return {topic: count for topic, count in counts.items() if count and topic in topics}


def _digest(message: Any) -> bytes:
    """Return a digest of joints and points, whatever the header."""
    whole = hashlib.sha256(repr(tuple(message.joint_names)).encode())
    for point in message.points:
        since = point.time_from_start
        vectors = [np.asarray(getattr(point, field), dtype=np.float64) for field in POINT_FIELDS]
        whole.update(repr((since.sec, since.nanosec, *map(len, vectors))).encode())
        for vector in vectors:
            whole.update(vector.tobytes())
    return whole.digest()


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
