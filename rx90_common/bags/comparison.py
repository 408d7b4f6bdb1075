"""Compare two bags value by value, with a verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import read_joint_bag, series_topics_text
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
    """What one of two series has and the other lacks, or has twice.

    Attributes:
        missing: stamps inside the common range that the other one lacks.
        first_missing_ns: the first of them.
        outside: messages before or after the common range.
        repeats: exact repetitions of a message, which were dropped.
        ambiguous: messages whose stamp an earlier one with other content has.
    """

    missing: int
    first_missing_ns: int | None
    outside: int
    repeats: int
    ambiguous: int


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
        notes: remarks for the user about the reading of the bags.
        shift_ns: offset added to the stamps of the second one.
    """

    path_a: Path
    path_b: Path
    topics: tuple[TopicComparison, ...]
    skipped: tuple[str, ...]
    notes: tuple[str, ...] = ()
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
        unknown = [field for field in self.fields if field not in FIELDS]
        if unknown or not self.fields:
            what = f"field {quoted(unknown[0])}" if unknown else "no fields to compare"
            raise BagError(f"{what}; accepted: {', '.join(FIELDS)}")
        if self.start_ns is not None and self.end_ns is not None and self.start_ns > self.end_ns:
            window = f"{self.start_ns / NANOSECONDS:g} s to {self.end_ns / NANOSECONDS:g} s"
            raise BagError(f"time window from {window}; accepted: a start before the end")
        if isinstance(self.align, str) and self.align not in (START, TRAJECTORY):
            raise BagError(f"align is {quoted(self.align)}; accepted: {START}, {TRAJECTORY}, or ns")

    def cut(self, series: JointSeries) -> JointSeries:
        """Return the part of a series that is compared."""
        stamps = series.stamp_ns
        no_bounds = np.iinfo(np.int64)
        inside = (stamps >= (no_bounds.min if self.start_ns is None else self.start_ns)) & (
            stamps <= (no_bounds.max if self.end_ns is None else self.end_ns)
        )
        left_out = {field: None for field in series.fields if field not in self.fields}
        part: JointSeries = replace(series, **left_out)  # type: ignore[arg-type]  # fields alone
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
    bag_a = read_joint_bag(path_a, chosen, mapping=mapping)
    bag_b = read_joint_bag(path_b, chosen, mapping=mapping)
    bags = (bag_a, bag_b)
    every = [topic for bag in bags for topic in bag.topics]
    there = {topic.name for topic in every if topic.is_joint_state}
    for bag in bags:
        if not any(topic.count for topic in bag.topics):
            raise BagError(f"{plain(bag.path)}: holds no messages")
        if not any(topic.is_joint_state for topic in bag.topics):
            others = listed(sorted({topic.name for topic in bag.topics}))
            raise BagError(f"{plain(bag.path)}: holds no JointState topic, only {others}")
    wanted = sorted(there) if chosen is None else chosen
    for topic in wanted:
        if topic not in there:
            raise BagError(f"topic {plain(topic)} is in neither bag; {series_topics_text(every)}")
    shift = time_shift(scope.align, bag_a, bag_b)
    found_a = bag_a.series
    found_b = bag_b.moved(shift).series
    series = [one for found in (found_a, found_b) for some in found.values() for one in some]
    joints = {topic: {name for one in series if one.topic == topic for name in one.names} for topic in wanted}
    tolerances.check(there, joints)
    results = [
        result
        for topic in wanted
        for result in _compare_topic(topic, (found_a.get(topic), found_b.get(topic)), tolerances, scope)
    ]
    if not results:
        neither = " nor ".join(plain(bag.path) for bag in bags)
        raise BagError(f"neither {neither} has a JointState message in the time window")
    if set(scope.fields) < set(FIELDS) and not any(r.values or r.verdict is not Verdict.SAME for r in results):
        # Bags would be the same by stamps alone.
        recorded = listed(dict.fromkeys(field for one in series for field in one.fields)) or "none"
        raise BagError(f"fields {', '.join(scope.fields)}: no message has any of them; accepted: some of {recorded}")
    skipped = tuple(sorted({topic.name for topic in every if not topic.is_joint_state}))
    notes = tuple(f"{plain(bag.path)}: {note}" for bag in bags for note in bag.notes)
    return BagComparison(bag_a.path, bag_b.path, tuple(results), skipped, notes, shift)


def _compare_topic(
    topic: str, found: tuple[list[JointSeries] | None, ...], tolerances: Tolerances, scope: Scope
) -> list[TopicComparison]:
    """Compare each set of joints of a topic; `found` is that of each bag, None where the bag lacks the topic."""
    first, second = (
        {frozenset(series.names): series for series in map(scope.cut, some or []) if len(series.stamp_ns)}
        for some in found
    )
    if not first and not second:
        return [] if scope.topics is None else [_incomparable(topic, "no message of it is in either bag")]
    if not first or not second:
        lacking = 1 if first else 0
        what = "the topic is not" if found[lacking] is None else "no message of it is"
        window = " within the time window" if found[lacking] else ""
        return [_incomparable(topic, f"{what} in the {_BAGS[lacking]} bag{window}")]
    pairs: list[tuple[JointSeries | None, JointSeries | None]] = []
    for joints in [joints for joints in first if joints in second]:
        pairs.append((first.pop(joints), second.pop(joints)))
    pairs += zip_longest(first.values(), second.values())  # those with other joints, in their order
    results = []
    for a, b in pairs:
        alone = a or b
        if a is not None and b is not None:
            results.append(compare_series(a, b, tolerances, scope))
        elif alone is not None:
            where = _BAGS[alone is b]
            results.append(_incomparable(topic, f"only the {where} bag has messages of {listed(alone.names)}"))
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
        spans = " against ".join(
            f"{len(t)} from {t.min() / NANOSECONDS:.9f} to {t.max() / NANOSECONDS:.9f} s" if len(t) else "none"
            for t in (a.stamp_ns, b.stamp_ns)
        )
        return _incomparable(a.topic, f"no stamp in common: {spans}; bags that began at other times can be aligned")
    reasons: list[str] = []
    for series, compared, where in ((a, b, "first"), (b, a, "second")):
        lacking = (
            listed(name for name in series.names if name not in compared.names),
            ", ".join(field for field in series.fields if field not in compared.fields),
        )
        reasons += [f"only the {where} bag has {what}" for what in lacking if what]
    units = [plain(one.units["effort"]) for one in (a, b) if "effort" in one.fields]
    if len(set(units)) > 1:
        reasons.append("effort is in {} in the first bag and in {} in the second, and not compared".format(*units))
    for side, where in zip((alignment.a, alignment.b), _BAGS, strict=True):
        if side.first_missing_ns is not None:
            reasons.append(
                f"only the {where} bag has {counted(side.missing, 'message')} of the common range, "
                f"the first at t = {side.first_missing_ns / NANOSECONDS:.9f} s"
            )
        if side.outside and not scope.common_range:
            reasons.append(f"only the {where} bag has {counted(side.outside, 'message')} outside the common range")
    values: list[ValueDifference] = []
    for field in FIELDS:
        if field in a.fields and field in b.fields and a.units[field] == b.units[field]:
            columns_a = a.fields[field][alignment.rows_a]
            columns_b = b.fields[field][alignment.rows_b]
            for joint in joints:
                pair = columns_a[:, a.names.index(joint)], columns_b[:, b.names.index(joint)]
                tolerance = tolerances.of(a.topic, joint, field)
                values.append(_difference(joint, field, a.units[field], *pair, alignment.stamp_ns, tolerance))
    verdict = Verdict.DIFFERS if reasons or any(value.beyond for value in values) else Verdict.SAME
    return TopicComparison(
        a.topic, joints, len(alignment.stamp_ns), alignment.range_ns, alignment.a, alignment.b, tuple(values),
        tuple(reasons), verdict,
    )  # fmt: skip


def _difference(
    joint: str, field: str, unit: str, a: Array, b: Array, stamp_ns: Int64Array, tolerance: float
) -> ValueDifference:
    a = np.ascontiguousarray(a)
    b = np.ascontiguousarray(b)
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
    (rows_a, keys_a) = _keys(a)
    (rows_b, keys_b) = _keys(b)
    stamps = keys_a["stamp"], keys_b["stamp"]
    alone = not (keys_a["occurrence"].any() or keys_b["occurrence"].any())  # stamps alone are sorted faster
    left, right = stamps if alone else (keys_a, keys_b)
    _, *matched = np.intersect1d(left, right, assume_unique=True, return_indices=True)
    low, high = (max(int(t[0]) for t in stamps), min(int(t[-1]) for t in stamps)) if all(map(len, stamps)) else (1, 0)
    sides = []
    for series, keys, rows in zip((a, b), (keys_a, keys_b), matched, strict=True):
        inside = (keys["stamp"] >= low) & (keys["stamp"] <= high)
        missing = np.setdiff1d(np.flatnonzero(inside), rows)
        first = int(keys["stamp"][missing[0]]) if len(missing) else None
        repeats = len(series.stamp_ns) - len(keys)
        ambiguous = int((keys["occurrence"] > 0).sum())
        sides.append(Side(len(missing), first, int((~inside).sum()), repeats, ambiguous))
    common = (low, high) if low <= high else None
    return Alignment(rows_a[matched[0]], rows_b[matched[1]], stamps[0][matched[0]], common, *sides)


def _keys(series: JointSeries) -> tuple[NDArray[np.intp], NDArray[np.void]]:
    """Return the rows that are no repetitions, by stamp, and their stamps and numbers among those with the same."""
    rows = np.argsort(series.stamp_ns, kind="stable")
    stamp = series.stamp_ns[rows]
    keys = np.zeros(len(rows), dtype=_KEY)
    keep = np.ones(len(rows), dtype=np.bool_)
    keys["stamp"] = stamp
    occurrences: dict[bytes, int] = {}
    again = np.append(False, stamp[1:] == stamp[:-1])
    for i in np.flatnonzero(again | np.append(again[1:], False)).tolist():  # all those that share a stamp
        content = b"".join(values[rows[i]].tobytes() for values in series.fields.values())
        if not again[i]:
            occurrences = {}
        keep[i] = content not in occurrences
        keys["occurrence"][i] = occurrences.setdefault(content, len(occurrences))
    return rows[keep], keys[keep]
