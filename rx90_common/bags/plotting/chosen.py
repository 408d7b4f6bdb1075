"""Which topics and joints of one or two bags are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.reading import JointBag, picked, read_joint_bag
from rx90_common.bags.storage import BagReader
from rx90_common.bags.time_shift import moved, time_shift
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted

USUAL = ("/joint_states", "/friction_states", "/rx90_controller/tracking_error")
"""What is drawn unless topics are chosen."""
_PARTS = 1000  # of each bag, in which progress is told


def read_chosen(
    paths: Sequence[Path],
    topics: Sequence[str] | None,
    joints: Sequence[str] | None,
    align: int | str,
    most: int,
    progress: Callable[[int, int], None],
) -> list[tuple[JointSeries, ...]]:
    """Return a series of each bag for each topic, with equal joints.

    Args:
        paths: one bag or two.
        topics: topic names; by default the first `most` of USUAL that the bags have, or else their first topic.
        joints: names; by default all.
        align: what the stamps of the second bag are moved by, as in `compare_bags`.
        most: topics by default.
        progress: called with how much of the bags is read, and of how much; no unit.

    Raises:
        BagError: if a bag cannot be read, or a topic or joint is not there, with what is.
    """
    there = [_topics(path, topics) for path in paths]
    both = [name for name in there[0] if all(name in names for names in there)]
    if not both:
        a, b = (f"{plain(path)} has {listed(names)}" for path, names in zip(paths, there, strict=True))
        raise BagError(f"no topic is in both bags: {a}; {b}")
    usual = [name for name in USUAL if name in both][:most] or both[:1]
    wanted = both if topics is not None else usual

    def tell(before: int, done: int, total: int) -> None:
        progress(_PARTS * before + _PARTS * done // total, _PARTS * len(paths))

    bags = [read_joint_bag(path, wanted, partial(tell, k)) for k, path in enumerate(paths)]
    found = [bag.series for bag in bags]
    if len(bags) > 1:
        found[1] = moved(found[1], time_shift(align, bags[0], bags[1]))
    names = [name for name in wanted if name in found[0]]
    if topics is None and joints is not None:  # of the usual topics those that have these joints
        names = [name for name in names if all(_has(bag.series[name], joints) for bag in bags)] or names[:1]
    return [
        tuple(_joints(bag, series[name], joints) for bag, series in zip(bags, found, strict=True)) for name in names
    ]


def pairs(both: tuple[JointSeries, ...], names: Sequence[str]) -> tuple[JointSeries, JointSeries]:
    """Return the messages of two series that have the same stamp, in the order of stamps, with these joints.

    Raises:
        BagError: if there are none.
    """
    a, b = (series.select(names) for series in both)
    _, rows_a, rows_b = np.intersect1d(a.stamp_ns, b.stamp_ns, return_indices=True)
    if not len(rows_a):
        spans = [f"{one.time.min():.9g} to {one.time.max():.9g} s" for one in both]
        raise BagError(
            f"{plain(a.topic)}: no stamp is in both bags, t = {spans[0]} and {spans[1]}; accepted: bags of the same "
            "times, or --align start"
        )
    return a.take(rows_a), b.take(rows_b)


def _topics(path: Path, topics: Sequence[str] | None) -> list[str]:
    with BagReader(path) as bag:
        if topics is not None:
            wanted = picked(path, bag.topics, topics)
            for topic in wanted:
                if not topic.count:
                    raise BagError(f"{plain(path)}: no messages in {plain(topic.name)}")
            return [topic.name for topic in wanted]
        names = [topic.name for topic in bag.topics if topic.holds_series and topic.count]
        if not names:
            there = listed(topic.name for topic in bag.topics) or "nothing"
            raise BagError(f"{plain(path)}: holds no joint states or temperatures, only {there}")
        return names


def _has(found: Sequence[JointSeries], joints: Sequence[str]) -> bool:
    return any(set(joints) <= set(series.names) for series in found)


def _joints(bag: JointBag, found: Sequence[JointSeries], joints: Sequence[str] | None) -> JointSeries:
    where = f"{plain(bag.path)}: {plain(found[0].topic)}"
    if joints is None:
        if len(found) > 1:
            sets = "; ".join(listed(series.names) for series in found)
            raise BagError(f"{where} carries several sets of joints: {sets}; say which with --joint")
        return found[0]
    fitting = [series for series in found if set(joints) <= set(series.names)]
    if not fitting:
        known = dict.fromkeys(name for series in found for name in series.names)
        missing = next((name for name in joints if name not in known), joints[0])
        raise BagError(f"{where}: no joint {quoted(missing)}; there are {listed(known)}")
    return fitting[0].select(joints)
