"""Further content of a bag: robot, parameters, trajectories; and the alignment of two bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from rx90_common.bags.reading import BagReader, JointBag
from rx90_common.bags.topics import JOINT_TRAJECTORY
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed
from rx90_common.base.rates import message_time_ns
from rx90_common.exchange.topics import TRAJECTORY_ACCEPTED

START = "start"
TRAJECTORY = "trajectory"


class RecordedTrajectory(NamedTuple):
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
    """
    with BagReader(path) as bag:
        kind = [topic for topic in bag.topics if topic.msgtype == JOINT_TRAJECTORY]
        fitting = [topic for topic in kind if topic.name.rpartition("/")[2] == TRAJECTORY_ACCEPTED]
        if len(fitting) > 1:
            what = f"has the trajectories of several controllers, {listed(sorted(topic.name for topic in fitting))}"
            raise BagError(f"{what}; accepted: those of one")
        if not fitting or not fitting[0].count:
            raise BagError(
                f"no trajectory in it; accepted: a bag with rx90_controller/{TRAJECTORY_ACCEPTED}, "
                "which rx90 bag record and rx90 run write"
            )
        found = [bag.deserialize(topic, data) for topic, _, data in bag.messages(fitting)]
    trajectories = [RecordedTrajectory(message_time_ns(m.header.stamp), m) for m in found]
    return sorted(trajectories, key=lambda one: one.start_ns)


def time_shift(align: int | str, first: JointBag, second: JointBag) -> int:
    """Return the offset to add to the stamps of the second of two bags, ns; `align` as in `Scope`."""
    if isinstance(align, int):
        return align
    if align == TRAJECTORY:
        return (
            read_trajectories(first.path)[-1].start_ns - read_trajectories(second.path)[-1].start_ns
        )
    return first.begin_ns - second.begin_ns
