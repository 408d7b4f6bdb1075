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
from rx90_common.bags.reading import JointBag, read_joint_bag, series_topics_text
from rx90_common.bags.recorded import START, TRAJECTORY, time_shift
from rx90_common.bags.tolerance import Tolerances
from rx90_common.bags.topics import FIELDS, absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, check_type
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_KEY = np.dtype([("stamp", np.int64), ("occurrence", np.int64)])
_BAGS = ("first", "second")


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
        not_finite: number of pairs with only one NaN, or with unequal infinities; without a tolerance
            also those of two NaN with other bits.
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
    """The comparison of one topic, or of one set of joints in it.

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
        fields: some of position, velocity, effort.
        start_ns: messages before this stamp are left out.
        end_ns: messages after this stamp are left out.
        common_range: stamps outside the common range are ignored.
        align: offset added to the stamps of the second bag before the comparison: ns, or START, so that both
            bags begin at the same time, or TRAJECTORY, so that their last trajectories do.
    """

    topics: tuple[str, ...] | None = None
    fields: tuple[str, ...] = FIELDS
    start_ns: int | None = None
    end_ns: int | None = None
    common_range: bool = False
    align: int | str = 0

    def __post_init__(self) -> None:
        if not self.fields or not set(self.fields) <= set(FIELDS):
            raise BagError(f"fields {listed(self.fields) or 'none'}; accepted: some of {', '.join(FIELDS)}")
        if isinstance(self.align, str) and self.align not in (START, TRAJECTORY):
            raise BagError(f"align is {quoted(self.align)}; accepted: {START}, {TRAJECTORY}, or ns")

    def cut(self, series: JointSeries) -> JointSeries:
        """Return the part of a series that is compared."""
        inside = np.ones(len(series.stamp_ns), dtype=np.bool_)
        if self.start_ns is not None:
            inside &= series.stamp_ns >= self.start_ns
        if self.end_ns is not None:
            inside &= series.stamp_ns <= self.end_ns
        part = series.only(self.fields)
        return part if inside.all() else part.take(inside)


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
    check_type(tolerances=(tolerances, Tolerances), scope=(scope, Scope))
    chosen = None if scope.topics is None else [absolute(topic) for topic in scope.topics]
    first = read_joint_bag(path_a, chosen, mapping=mapping)
    second = read_joint_bag(path_b, chosen, mapping=mapping)
    for bag in (first, second):
        if not any(topic.count for topic in bag.topics):
            raise BagError(f"{plain(bag.path)}: holds no messages")
        if not any(topic.is_joint_state for topic in bag.topics):
            raise BagError(f"{plain(bag.path)}: holds no JointState topic, only {listed(t.name for t in bag.topics)}")
    every = [*first.topics, *second.topics]
    there = sorted({topic.name for topic in every if topic.is_joint_state})
    for topic in chosen or ():
        if topic not in there:
            raise BagError(f"topic {plain(topic)} is in neither bag; {series_topics_text(every)}")
    shift = time_shift(scope.align, first, second)
    second = second.moved(shift)
    joints: dict[str, set[str]] = {topic: set() for topic in chosen or there}
    for bag in (first, second):
        for topic, sets in bag.series.items():
            joints[topic].update(name for series in sets for name in series.names)
    tolerances.check(there, joints)
    results: list[TopicComparison] = []
    for topic in joints:
        results += _compare_topic(topic, (first, second), tolerances, scope)
    if not results:
        raise BagError(f"neither {plain(first.path)} nor {plain(second.path)} has a JointState message in the window")
    if set(scope.fields) < set(FIELDS) and not any(r.values or r.verdict is not Verdict.SAME for r in results):
        parts = [series for bag in (first, second) for sets in bag.series.values() for series in sets]
        recorded = listed(dict.fromkeys(field for series in parts for field in series.fields))
        raise BagError(f"fields {', '.join(scope.fields)}: no message has any of them; accepted: some of {recorded}")
    skipped = tuple(sorted({topic.name for topic in every if not topic.is_joint_state}))
    return BagComparison(first.path, second.path, tuple(results), skipped, shift)


def _compare_topic(
    topic: str, bags: tuple[JointBag, JointBag], tolerances: Tolerances, scope: Scope
) -> list[TopicComparison]:
    """Compare each set of joints of a topic; a single one of each bag even where they differ."""
    sets: list[dict[frozenset[str], JointSeries]] = []
    for bag in bags:
        parts = [scope.cut(series) for series in bag.series.get(topic, ())]
        sets.append({frozenset(part.names): part for part in parts if len(part.stamp_ns)})
    first, second = sets
    if not first and not second:
        return [] if scope.topics is None else [_incomparable(topic, "no message of it is in either bag")]
    if len(first) == len(second) == 1:
        (series_a,) = first.values()
        (series_b,) = second.values()
        return [compare_series(series_a, series_b, tolerances, scope)]
    results = []
    for joints in dict.fromkeys([*first, *second]):
        if joints in first and joints in second:
            results.append(compare_series(first[joints], second[joints], tolerances, scope))
        else:
            where = _BAGS[joints in second]
            results.append(_incomparable(topic, f"only the {where} bag has messages of {listed(sorted(joints))}"))
    return results


def compare_series(
    a: JointSeries, b: JointSeries, tolerances: Tolerances | None = None, scope: Scope | None = None
) -> TopicComparison:
    """Compare two series as `compare_bags` does, aligned on stamps and joint names."""
    tolerances = tolerances or Tolerances()
    scope = scope or Scope()
    check_type(a=(a, JointSeries), b=(b, JointSeries), tolerances=(tolerances, Tolerances), scope=(scope, Scope))
    a = scope.cut(a)
    b = scope.cut(b)
    joints = tuple(name for name in a.names if name in b.names)
    if not joints:
        return _incomparable(a.topic, f"no joint in common: {listed(a.names)} against {listed(b.names)}")
    alignment = align(a, b)
    if not len(alignment.stamp_ns):
        return _incomparable(a.topic, "no stamp in common; bags that began at other times can be aligned")
    reasons: list[str] = []
    for where, series, compared, side in (("first", a, b, alignment.a), ("second", b, a, alignment.b)):
        lacking = [name for name in series.names if name not in compared.names]
        lacking += [field for field in series.fields if field not in compared.fields]
        if lacking:
            reasons.append(f"only the {where} bag has {listed(lacking)}")
        if side.first_missing_ns is not None:
            reasons.append(
                f"only the {where} bag has {counted(side.missing, 'message')} of the common range, "
                f"the first at t = {side.first_missing_ns / NANOSECONDS:.9f} s"
            )
        if side.outside and not scope.common_range:
            reasons.append(f"only the {where} bag has {counted(side.outside, 'message')} outside the common range")
    both = [field for field in a.fields if field in b.fields]
    if "effort" in both and a.units["effort"] != b.units["effort"]:
        both.remove("effort")
        units = f"{plain(a.units['effort'])} in the first bag and in {plain(b.units['effort'])} in the second"
        reasons.append(f"effort is in {units}, and not compared")
    values: list[ValueDifference] = []
    for field in both:
        for joint in joints:
            tolerance = tolerances.of(a.topic, joint, field)
            column_a = _column(a, field, joint, alignment.rows_a)
            column_b = _column(b, field, joint, alignment.rows_b)
            unit = a.units[field]
            values.append(_difference(joint, field, unit, column_a, column_b, alignment.stamp_ns, tolerance))
    verdict = Verdict.DIFFERS if reasons or any(value.beyond for value in values) else Verdict.SAME
    return TopicComparison(
        a.topic, joints, len(alignment.stamp_ns), alignment.range_ns, alignment.a, alignment.b, tuple(values),
        tuple(reasons), verdict,
    )  # fmt: skip


def _column(series: JointSeries, field: str, joint: str, rows: NDArray[np.intp]) -> Array:
    return np.ascontiguousarray(series.fields[field][rows, series.names.index(joint)])


def _difference(
    joint: str, field: str, unit: str, a: Array, b: Array, stamp_ns: Int64Array, tolerance: float
) -> ValueDifference:
    finite = np.isfinite(a) & np.isfinite(b)
    equal_bits = a.view(np.int64) == b.view(np.int64)
    # Without a tolerance, two NaN with other bits are not the same.
    both_nan = np.isnan(a) & np.isnan(b) & (tolerance > 0.0)
    not_finite = int((~finite & ~(equal_bits | (a == b) | both_nan)).sum())
    with np.errstate(over="ignore"):
        distance = np.abs(np.where(finite, a, 0.0) - np.where(finite, b, 0.0))
    distance = np.minimum(distance, np.finfo(np.float64).max)
    beyond = distance > tolerance if tolerance > 0.0 else finite & ~equal_bits
    largest = int(np.argmax(distance))
    maximum = float(distance[largest])
    at_ns = None
    rms = 0.0
    if maximum > 0.0:  # scaled by it, so that the squares neither under- nor overflow
        at_ns = int(stamp_ns[largest])
        rms = maximum * float(np.sqrt(np.sum((distance / maximum) ** 2) / finite.sum()))
    count = int(beyond.sum()) + not_finite
    return ValueDifference(joint, field, unit, maximum, at_ns, rms, tolerance, count, not_finite)


def _incomparable(topic: str, reason: str) -> TopicComparison:
    return TopicComparison(topic, (), 0, None, None, None, (), (reason,), Verdict.INCOMPARABLE)


class Alignment(NamedTuple):
    """Pairs of rows with equal stamps, in their order; `range_ns` is the stamps' common range, if any."""

    rows_a: NDArray[np.intp]
    rows_b: NDArray[np.intp]
    stamp_ns: Int64Array
    range_ns: tuple[int, int] | None
    a: Side
    b: Side


def align(a: JointSeries, b: JointSeries) -> Alignment:
    """Pair the messages of two series by stamp.

    Several messages with one stamp: exact repetitions count once; different ones are paired in their order,
    the first with the first and so on.
    """
    rows_a, keys_a = _keys(a)
    rows_b, keys_b = _keys(b)
    _, matched_a, matched_b = np.intersect1d(keys_a, keys_b, assume_unique=True, return_indices=True)
    stamp_a = a.stamp_ns[rows_a]
    stamp_b = b.stamp_ns[rows_b]
    common = None
    if (
        len(stamp_a)
        and len(stamp_b)
        and (low := max(stamp_a[0], stamp_b[0])) <= (high := min(stamp_a[-1], stamp_b[-1]))
    ):
        common = int(low), int(high)
    return Alignment(
        rows_a[matched_a], rows_b[matched_b], stamp_a[matched_a], common,
        _side(stamp_a, matched_a, common), _side(stamp_b, matched_b, common),
    )  # fmt: skip


def _side(stamp_ns: Int64Array, matched: NDArray[np.intp], common: tuple[int, int] | None) -> Side:
    low, high = common or (0, -1)
    inside = (stamp_ns >= low) & (stamp_ns <= high)
    missing = stamp_ns[np.setdiff1d(np.flatnonzero(inside), matched)]
    return Side(len(missing), int(missing[0]) if len(missing) else None, int((~inside).sum()))


def _keys(series: JointSeries) -> tuple[NDArray[np.intp], NDArray[np.void]]:
    """Return the rows that are no repetitions, by stamp, and their stamps and numbers among those with the same."""
    rows = np.argsort(series.stamp_ns, kind="stable")
    stamp = series.stamp_ns[rows]
    if (np.diff(stamp) == 0).any():
        bits = np.column_stack([stamp, *(values[rows].view(np.int64) for values in series.fields.values())])
        _, first = np.unique(bits, axis=0, return_index=True)
        rows = rows[np.sort(first)]
        stamp = series.stamp_ns[rows]
    keys = np.zeros(len(rows), dtype=_KEY)
    keys["stamp"] = stamp
    keys["occurrence"] = np.arange(len(rows)) - np.searchsorted(stamp, stamp)
    return rows, keys
