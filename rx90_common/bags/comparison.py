"""Compare two bags value by value, with a verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import read_joint_bag
from rx90_common.bags.recorded import START, TRAJECTORY, time_shift
from rx90_common.bags.tolerance import Tolerances
from rx90_common.base.arrays import Array, Index
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_KEY = np.dtype([("stamp", np.int64), ("occurrence", np.int64)])


class Verdict(IntEnum):
    """The verdict of a comparison; its number is the exit code, and the worst topic's is that of the bags."""

    SAME = 0
    DIFFERS = 1
    INCOMPARABLE = 2


@dataclass(frozen=True)
class Side:
    """What one of two series has and the other lacks.

    Attributes:
        missing: messages inside the common range that the other one lacks.
        first_missing_ns: stamp of the first of them.
        outside: messages before or after the common range.
    """

    missing: int
    first_missing_ns: int | None
    outside: int


@dataclass(frozen=True)
class ValueDifference:
    """The differences of one field of one joint over the pairs of messages.

    Attributes:
        joint: joint name.
        field: position, velocity or effort.
        unit: of both and of the difference.
        maximum: largest absolute difference of finite values.
        at_ns: stamp of that difference; None when it is 0.
        rms: root mean square of the differences of finite values.
        tolerance: the largest difference accepted; 0 requires equal bits.
        beyond: number of pairs beyond the tolerance, also those that `not_finite` counts.
        not_finite: number of these whose difference is no finite number.
    """

    joint: str
    field: str
    unit: str
    maximum: float
    at_ns: int | None
    rms: float
    tolerance: float
    beyond: int
    not_finite: int


@dataclass(frozen=True)
class TopicComparison:
    """The comparison of one topic.

    Attributes:
        topic: absolute topic name.
        joints: the joints that both bags have, in the order of the first.
        pairs: number of messages compared.
        range_ns: first and last stamp of the common range.
        a: messages and joints of the first bag only.
        b: those of the second bag only.
        values: the differences by field and joint.
        reasons: why the topic differs or cannot be compared, values aside.
        verdict: on this topic.
    """

    topic: str
    joints: tuple[str, ...]
    pairs: int
    range_ns: tuple[int, int] | None
    a: Side | None
    b: Side | None
    values: tuple[ValueDifference, ...]
    reasons: tuple[str, ...]
    verdict: Verdict

    @property
    def identical(self) -> bool:
        """Return whether the messages that were compared are the same bit for bit: no tolerance has been used."""
        return self.verdict is Verdict.SAME and all(value.tolerance == 0.0 for value in self.values)


@dataclass(frozen=True)
class BagComparison:
    """The comparison of two bags.

    Attributes:
        path_a: the first one.
        path_b: the second one.
        topics: the comparison of each topic.
        skipped: names of the topics that are no JointState.
        shift_ns: offset added to the stamps of the second one.
    """

    path_a: Path
    path_b: Path
    topics: tuple[TopicComparison, ...]
    skipped: tuple[str, ...]
    shift_ns: int = 0

    @property
    def verdict(self) -> Verdict:
        """Return the worst verdict of all topics."""
        return max(topic.verdict for topic in self.topics)


@dataclass(frozen=True)
class Scope:
    """The scope of a comparison.

    Attributes:
        topics: only these; by default all JointState topics, each of which must then be in both bags.
        common_range: stamps outside the common range are ignored.
        align: offset added to the stamps of the second bag before the comparison: ns, or START, so that both
            bags begin at the same time, or TRAJECTORY, so that their last trajectories do.
    """

    topics: tuple[str, ...] | None = None
    common_range: bool = False
    align: int | str = 0

    def __post_init__(self) -> None:
        if isinstance(self.align, str) and self.align not in (START, TRAJECTORY):
            raise BagError(f"align is {quoted(self.align)}; accepted: {START}, {TRAJECTORY}, or ns")


def compare_bags(
    path_a: Path | str,
    path_b: Path | str,
    tolerances: Tolerances | None = None,
    scope: Scope | None = None,
    mapping: LogMapping | None = None,
) -> BagComparison:
    """Compare the JointState topics of two bags.

    Args:
        path_a: a bag.
        path_b: the other one.
        tolerances: accepted differences of values; by default none, not even of a single bit.
        scope: of the comparison; by default everything.
        mapping: of the columns of tables; by default the files beside them.

    Raises:
        BagError: if a bag cannot be read, nothing can be compared, or a tolerance matches no value.
    """
    tolerances = tolerances or Tolerances()
    scope = scope or Scope()
    first = read_joint_bag(path_a, scope.topics, mapping=mapping, all_there=True)
    second = read_joint_bag(path_b, scope.topics, mapping=mapping, all_there=True)
    shift = time_shift(scope.align, first, second)
    second = second.moved(shift)
    topics = sorted({*first.series, *second.series})
    joints = {name for part in (*first.parts, *second.parts) for name in part.names}
    tolerances.check(topics, joints)
    results = []
    for topic in topics:
        both = [bag.one(topic) for bag in (first, second) if bag.series.get(topic)]
        if len(both) == 2:
            results.append(compare_series(both[0], both[1], tolerances, scope))
        elif both:
            where = "first" if first.series.get(topic) else "second"
            results.append(_incomparable(topic, f"only the {where} bag has messages of it"))
    if not results:
        raise BagError(
            f"neither {plain(first.path)} nor {plain(second.path)} has a JointState message"
        )
    others = {topic.name for topic in (*first.topics, *second.topics) if not topic.is_joint_state}
    return BagComparison(first.path, second.path, tuple(results), tuple(sorted(others)), shift)


def compare_series(
    a: JointSeries, b: JointSeries, tolerances: Tolerances | None = None, scope: Scope | None = None
) -> TopicComparison:
    """Compare two series as `compare_bags` does, aligned on stamps and joint names."""
    tolerances = tolerances or Tolerances()
    scope = scope or Scope()
    joints = tuple(name for name in a.names if name in b.names)
    if not joints:
        return _incomparable(
            a.topic, f"no joint in common: {listed(a.names)} against {listed(b.names)}"
        )
    if not np.isin(a.stamp_ns, b.stamp_ns).any():
        return _incomparable(
            a.topic, "no stamp in common; bags that began at other times can be aligned"
        )
    alignment = align(a, b)
    reasons = _only_in("first", a, b, alignment.a, scope)
    reasons += _only_in("second", b, a, alignment.b, scope)
    fields = [field for field in a.fields if field in b.fields]
    if "effort" in fields and a.units["effort"] != b.units["effort"]:
        fields.remove("effort")
        units = f"{plain(a.units['effort'])} in the first bag and in {plain(b.units['effort'])} in the second"
        reasons.append(f"effort is in {units}, and not compared")
    values = []
    for field in fields:
        for joint in joints:
            tolerance = tolerances.of(a.topic, joint, field)
            values_a = a.fields[field][alignment.rows_a, a.names.index(joint)]
            values_b = b.fields[field][alignment.rows_b, b.names.index(joint)]
            unit = a.units[field]
            values.append(
                _difference(joint, field, unit, values_a, values_b, alignment.stamp_ns, tolerance)
            )
    verdict = Verdict.DIFFERS if reasons or any(value.beyond for value in values) else Verdict.SAME
    return TopicComparison(
        a.topic, joints, len(alignment.stamp_ns), alignment.range_ns, alignment.a, alignment.b, tuple(values),
        tuple(reasons), verdict,
    )  # fmt: skip


def _only_in(
    where: str, series: JointSeries, compared: JointSeries, side: Side, scope: Scope
) -> list[str]:
    """Return what a series has and the one that it is compared with lacks, in words."""
    lacking = [name for name in series.names if name not in compared.names]
    lacking += [field for field in series.fields if field not in compared.fields]
    parts = [listed(lacking)] if lacking else []
    if side.first_missing_ns is not None:
        first = f"the first at t = {side.first_missing_ns / NANOSECONDS:.9f} s"
        parts.append(f"{counted(side.missing, 'message')} of the common range, {first}")
    if side.outside and not scope.common_range:
        parts.append(f"{counted(side.outside, 'message')} outside the common range")
    return [f"only the {where} bag has {part}" for part in parts]


def _difference(
    joint: str, field: str, unit: str, a: Array, b: Array, stamp_ns: Int64Array, tolerance: float
) -> ValueDifference:
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.abs(a - b)
    beyond = a.view(np.int64) != b.view(np.int64)
    if tolerance > 0.0:
        beyond &= ~(distance <= tolerance) & ~(np.isnan(a) & np.isnan(b))
    finite = np.isfinite(distance)
    distance = np.where(finite, distance, 0.0)
    largest = int(np.argmax(distance))
    maximum = float(distance[largest])
    at_ns = None
    rms = 0.0
    if maximum > 0.0:  # scaled by it, so that the squares neither under- nor overflow
        at_ns = int(stamp_ns[largest])
        rms = maximum * float(np.sqrt(np.sum((distance / maximum) ** 2) / finite.sum()))
    not_finite = int((beyond & ~finite).sum())
    return ValueDifference(
        joint, field, unit, maximum, at_ns, rms, tolerance, int(beyond.sum()), not_finite
    )


def _incomparable(topic: str, reason: str) -> TopicComparison:
    return TopicComparison(topic, (), 0, None, None, None, (), (reason,), Verdict.INCOMPARABLE)


class Alignment(NamedTuple):
    """Pairs of rows with equal stamps, in their order; `range_ns` is the stamps' common range."""

    rows_a: Index
    rows_b: Index
    stamp_ns: Int64Array
    range_ns: tuple[int, int]
    a: Side
    b: Side


def align(a: JointSeries, b: JointSeries) -> Alignment:
    """Pair the messages of two series, neither of them empty, by stamp.

    Several messages with one stamp: exact repetitions count once; different ones are paired in their order,
    the first with the first and so on.
    """
    rows_a, keys_a = _keys(a)
    rows_b, keys_b = _keys(b)
    _, paired_a, paired_b = np.intersect1d(keys_a, keys_b, assume_unique=True, return_indices=True)
    stamp_a = a.stamp_ns[rows_a]
    stamp_b = b.stamp_ns[rows_b]
    common = int(max(stamp_a[0], stamp_b[0])), int(min(stamp_a[-1], stamp_b[-1]))
    side_a = _side(np.delete(stamp_a, paired_a), common)
    side_b = _side(np.delete(stamp_b, paired_b), common)
    return Alignment(rows_a[paired_a], rows_b[paired_b], stamp_a[paired_a], common, side_a, side_b)


def _side(single_ns: Int64Array, common: tuple[int, int]) -> Side:
    """Count the stamps without a partner."""
    missing = single_ns[(single_ns >= common[0]) & (single_ns <= common[1])]
    first = int(missing[0]) if len(missing) else None
    return Side(len(missing), first, len(single_ns) - len(missing))


def _keys(series: JointSeries) -> tuple[Index, NDArray[np.void]]:
    """Return the rows that are no repetitions, by stamp, and their stamps and numbers among those with the same."""
    rows = np.arange(len(series.stamp_ns))
    if len(np.unique(series.stamp_ns)) < len(rows):
        bits = np.column_stack(
            [series.stamp_ns, *(values.view(np.int64) for values in series.fields.values())]
        )
        rows = np.sort(np.unique(bits, axis=0, return_index=True)[1])
    rows = rows[np.argsort(series.stamp_ns[rows], kind="stable")]
    keys = np.zeros(len(rows), dtype=_KEY)
    keys["stamp"] = series.stamp_ns[rows]
    keys["occurrence"] = np.arange(len(rows)) - np.searchsorted(keys["stamp"], keys["stamp"])
    return rows, keys
