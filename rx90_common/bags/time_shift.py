"""What the stamps of one of two bags are moved by, so that the two can be laid over each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import JointBag
from rx90_common.bags.trajectories import read_trajectories
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

START = "start"
TRAJECTORY = "trajectory"


def shift_between(bag_a: JointBag, bag_b: JointBag, align: int | str) -> int:
    """Return what to add to the stamps of the second bag, ns; `align` as in `Scope`.

    Raises:
        BagError: if a bag has no trajectory, for TRAJECTORY, or no message, for START.
    """
    bags = (bag_a, bag_b)
    return time_shift(align, [bag.path for bag in bags], lambda number: _first_stamp(bags[number]))


def time_shift(align: int | str, paths: Sequence[Path], first_stamp: Callable[[int], int]) -> int:
    """Return what to add to the stamps of the second of two bags, ns.

    Args:
        align: as in `Scope`.
        paths: of both bags.
        first_stamp: gives the time at which the bag of this number begins, ns; asked for START alone.

    Raises:
        BagError: if a bag has no trajectory, for TRAJECTORY.
    """
    if isinstance(align, int):
        return align
    if align == TRAJECTORY:
        starts = [read_trajectories(path)[-1].start_ns for path in paths]
    else:
        starts = [first_stamp(number) for number in range(2)]
    return starts[0] - starts[1]


def _first_stamp(bag: JointBag) -> int:
    stamps = [int(one.stamp_ns.min()) for found in bag.series.values() for one in found if len(one.stamp_ns)]
    if not stamps:
        raise BagError(f"{plain(bag.path)}: holds no JointState message, so it has no start to be aligned")
    return min(stamps)


def moved(series: dict[str, list[JointSeries]], shift_ns: int) -> dict[str, list[JointSeries]]:
    """Return the series with stamps that much later, ns."""
    if not shift_ns:
        return series
    return {topic: [replace(one, stamp_ns=one.stamp_ns + shift_ns) for one in found] for topic, found in series.items()}
