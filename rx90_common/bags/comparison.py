"""Compare two bags value by value, with a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.reading import JointBag, read_joint_bag, series_topics
from rx90_common.bags.recorded import START, TRAJECTORY, moved, time_shift
from rx90_common.bags.tolerance import Tolerances
from rx90_common.bags.topics import SERIES_FIELDS, absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, check_type
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS

_KEY = np.dtype([("stamp", np.int64), ("occurrence", np.int64)])


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
    """How one field of one joint differs over the pairs of messages.

    Attributes:
        joint: joint name.
        field: position, velocity, effort or temperature.
        unit: of both and of the difference.
        maximum: largest absolute difference of finite values.
        at_ns: stamp of that difference; None when it is 0.
        rms: root mean square of the differences of finite values.
        tolerance: the largest difference accepted; 0 asks for equal bits.
        beyond: number of pairs beyond the tolerance, also those that `not_finite` counts.
        not_finite: number of pairs of which only one is NaN, or which are infinite and unequal; without a tolerance
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
        a: what only the first bag has.
        b: what only the second bag has.
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


@dataclass(frozen=True)
class BagComparison:
    """The comparison of two bags.

    Attributes:
        path_a: the first one.
        path_b: the second one.
        topics: the comparison of each topic.
        skipped: names of the topics that are no JointState or Temperature.
        notes: what was read otherwise than a bag says.
        shift_ns: what the stamps of the second one were moved by.
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
    """What is compared.

    Attributes:
        topics: only these; by default all JointState and Temperature topics, each of which must then be in both bags.
        fields: which of position, velocity, effort, temperature.
        start_ns: messages before this stamp are left out.
        end_ns: messages after this stamp are left out.
        common_range: stamps outside the common range make no difference.
        align: what the stamps of the second bag are moved by before they are compared: ns, or START, so that both
            bags begin at the same time, or TRAJECTORY, so that their last trajectories do.
    """

    topics: tuple[str, ...] | None = None
    fields: tuple[str, ...] = SERIES_FIELDS
    start_ns: int | None = None
    end_ns: int | None = None
    common_range: bool = False
    align: int | str = 0

    def __post_init__(self) -> None:
        for field in self.fields:
            if field not in SERIES_FIELDS:
                raise BagError(f"field {quoted(field)}; accepted: {', '.join(SERIES_FIELDS)}")
        if not self.fields:
            raise BagError(f"no fields to compare; accepted: {', '.join(SERIES_FIELDS)}")
        if self.start_ns is not None and self.end_ns is not None and self.start_ns > self.end_ns:
            window = f"{self.start_ns / NANOSECONDS:g} s to {self.end_ns / NANOSECONDS:g} s"
            raise BagError(f"time window from {window}; accepted: a start before the end")
        if isinstance(self.align, str) and self.align not in (START, TRAJECTORY):
            raise BagError(f"align is {quoted(self.align)}; accepted: {START}, {TRAJECTORY}, or ns")

    def cut(self, series: JointSeries) -> JointSeries:
        """Return the part of a series that is compared."""
        inside = np.ones(len(series.stamp_ns), dtype=np.bool_)
        if self.start_ns is not None:
            inside &= series.stamp_ns >= self.start_ns
        if self.end_ns is not None:
            inside &= series.stamp_ns <= self.end_ns
        part = series if inside.all() else series.take(inside)
        fields = {field: values for field, values in part.fields.items() if field in self.fields}
        return JointSeries(part.topic, part.names, part.stamp_ns, **fields, effort_unit=part.effort_unit)


def compare_bags(
    path_a: Path | str, path_b: Path | str, tolerances: Tolerances | None = None, scope: Scope | None = None
) -> BagComparison:
    """Compare the JointState and Temperature topics of two bags.

    Args:
        path_a: a bag.
        path_b: the other one.
        tolerances: what values may differ by; by default nothing, not by a single bit.
        scope: what is compared; by default everything.

    Raises:
        BagError: if a bag cannot be read, or there is nothing to compare, or a tolerance fits nothing.
    """
    tolerances, scope = tolerances or Tolerances(), scope or Scope()
    check_type(tolerances=(tolerances, Tolerances), scope=(scope, Scope))
    paths = (Path(path_a), Path(path_b))
    chosen = None if scope.topics is None else [absolute(topic) for topic in scope.topics]
    bag_a, bag_b = (read_joint_bag(path, chosen) for path in paths)
    both = _series_topics(bag_a) | _series_topics(bag_b)
    wanted = sorted(both) if chosen is None else chosen
    for topic in wanted:
        if topic not in both:
            raise BagError(f"topic {plain(topic)} is in neither bag; {series_topics([*bag_a.topics, *bag_b.topics])}")
    shift = time_shift(scope.align, bag_a, bag_b)
    series_a, series_b = bag_a.series, moved(bag_b.series, shift)
    joints = {
        topic: {name for found in (series_a, series_b) for s in found.get(topic, []) for name in s.names}
        for topic in wanted
    }
    tolerances.check(both, joints)
    results: list[TopicComparison] = []
    for topic in wanted:
        results += _compare_topic(topic, series_a.get(topic), series_b.get(topic), tolerances, scope)
    if not results:
        there = " nor ".join(plain(path) for path in paths)
        raise BagError(f"neither {there} has a JointState or Temperature message in the time window")
    _check_compared(results, scope, [*series_a.values(), *series_b.values()])
    skipped = {topic.name for bag in (bag_a, bag_b) for topic in bag.topics if not topic.holds_series}
    notes = tuple(f"{plain(bag.path)}: {note}" for bag in (bag_a, bag_b) for note in bag.notes)
    return BagComparison(*paths, tuple(results), tuple(sorted(skipped)), notes, shift)


def _check_compared(results: Sequence[TopicComparison], scope: Scope, series: Sequence[list[JointSeries]]) -> None:
    """Refuse fields of which no topic has any: bags would be the same by stamps alone."""
    found = any(one.values or one.verdict is not Verdict.SAME for one in results)
    if not found and set(scope.fields) < set(SERIES_FIELDS):
        there = dict.fromkeys(field for some in series for one in some for field in one.fields)
        fields = ", ".join(scope.fields)
        raise BagError(f"fields {fields}: no message has any of them; accepted: some of {', '.join(there) or 'none'}")


def _series_topics(bag: JointBag) -> set[str]:
    """Return the names of a bag's topics of joint states and temperatures."""
    ours = {topic.name for topic in bag.topics if topic.holds_series}
    if not any(topic.count for topic in bag.topics):
        raise BagError(f"{plain(bag.path)}: holds no messages")
    if not ours:
        others = listed(sorted({topic.name for topic in bag.topics}))
        raise BagError(f"{plain(bag.path)}: holds no JointState or Temperature topic, only {others}")
    return ours


def _compare_topic(
    topic: str,
    found_a: list[JointSeries] | None,
    found_b: list[JointSeries] | None,
    tolerances: Tolerances,
    scope: Scope,
) -> list[TopicComparison]:
    """Compare each set of joints of a topic."""
    cut_a, cut_b = (_cut(found, scope) for found in (found_a, found_b))
    if not cut_a and not cut_b:
        return [] if scope.topics is None else [_incomparable(topic, "no message of it is in either bag")]
    if not cut_a or not cut_b:
        lacking, found = ("first", found_a) if not cut_a else ("second", found_b)
        what = "the topic is not" if found is None else "no message of it is"
        within = "" if not found else " within the time window"
        return [_incomparable(topic, f"{what} in the {lacking} bag{within}")]
    results = []
    for series_a, series_b in _pair_up(cut_a, cut_b):
        if series_a is None or series_b is None:
            there, where = (series_a, "first") if series_a is not None else (series_b, "second")
            names = listed(there.names) if there is not None else ""
            results.append(_incomparable(topic, f"only the {where} bag has messages of {names}"))
        else:
            results.append(compare_series(series_a, series_b, tolerances, scope))
    return results


def _cut(found: list[JointSeries] | None, scope: Scope) -> list[JointSeries]:
    return [part for series in found or [] if len((part := scope.cut(series)).stamp_ns)]


def _pair_up(
    found_a: Sequence[JointSeries], found_b: Sequence[JointSeries]
) -> list[tuple[JointSeries | None, JointSeries | None]]:
    """Pair series with the same set of joints; what is left on both sides is paired in its order."""
    left_b = list(found_b)
    pairs: list[tuple[JointSeries | None, JointSeries | None]] = []
    left_a: list[JointSeries] = []
    for a in found_a:
        same = next((b for b in left_b if set(b.names) == set(a.names)), None)
        if same is None:
            left_a.append(a)
        else:
            left_b.remove(same)
            pairs.append((a, same))
    for i in range(max(len(left_a), len(left_b))):
        pairs.append((left_a[i] if i < len(left_a) else None, left_b[i] if i < len(left_b) else None))
    return pairs


def compare_series(
    a: JointSeries, b: JointSeries, tolerances: Tolerances | None = None, scope: Scope | None = None
) -> TopicComparison:
    """Compare two series as `compare_bags` does, aligned on stamps and joint names."""
    tolerances, scope = tolerances or Tolerances(), scope or Scope()
    check_type(a=(a, JointSeries), b=(b, JointSeries), tolerances=(tolerances, Tolerances), scope=(scope, Scope))
    a, b = scope.cut(a), scope.cut(b)
    joints = tuple(name for name in a.names if name in b.names)
    if not joints:
        return _incomparable(a.topic, f"no joint in common: {listed(a.names)} against {listed(b.names)}")
    alignment = align(a, b)
    if not len(alignment.stamp_ns):
        spans = f"{_span(a)} against {_span(b)}"
        return _incomparable(a.topic, f"no stamp in common: {spans}; bags that began at other times can be aligned")
    reasons = [*_other_reasons(a, b), *_stamp_reasons(alignment, scope)]
    values: list[ValueDifference] = []
    for field in SERIES_FIELDS:
        if field in a.fields and field in b.fields and a.units[field] == b.units[field]:
            columns_a = a.fields[field][alignment.rows_a]
            columns_b = b.fields[field][alignment.rows_b]
            for joint in joints:
                pair = columns_a[:, a.names.index(joint)], columns_b[:, b.names.index(joint)]
                tolerance = tolerances.of(a.topic, joint, field)
                values.append(_difference(joint, field, a.units[field], *pair, alignment, tolerance))
    differs = bool(reasons) or any(value.beyond for value in values)
    return TopicComparison(
        a.topic,
        joints,
        len(alignment.stamp_ns),
        alignment.range_ns,
        alignment.a,
        alignment.b,
        tuple(values),
        tuple(reasons),
        Verdict.DIFFERS if differs else Verdict.SAME,
    )


def _difference(
    joint: str, field: str, unit: str, a: Array, b: Array, alignment: Alignment, tolerance: float
) -> ValueDifference:
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    finite = np.isfinite(a) & np.isfinite(b)
    equal_bits = a.view(np.int64) == b.view(np.int64)
    # Without a tolerance, two NaN with other bits are not the same.
    both_nan = np.isnan(a) & np.isnan(b)
    same_but_not_finite = equal_bits | (a == b) | (both_nan if tolerance > 0.0 else False)
    not_finite = int((~finite & ~same_but_not_finite).sum())
    with np.errstate(over="ignore"):
        distance = np.abs(np.where(finite, a, 0.0) - np.where(finite, b, 0.0))
    distance = np.minimum(distance, np.finfo(np.float64).max)
    beyond = distance > tolerance if tolerance > 0.0 else finite & ~equal_bits
    largest = int(np.argmax(distance))
    maximum = float(distance[largest])
    rms = 0.0
    if maximum > 0.0:  # scaled by it, so that the squares neither under- nor overflow
        rms = maximum * float(np.sqrt(np.sum((distance / maximum) ** 2) / finite.sum()))
    return ValueDifference(
        joint,
        field,
        unit,
        maximum,
        int(alignment.stamp_ns[largest]) if maximum > 0.0 else None,
        rms,
        tolerance,
        int(beyond.sum()) + not_finite,
        not_finite,
    )


def _other_reasons(a: JointSeries, b: JointSeries) -> list[str]:
    """Return which joints and arrays only one of two series has."""
    reasons = []
    for one, other, where in ((a, b, "first"), (b, a, "second")):
        names = [name for name in one.names if name not in other.names]
        if names:
            reasons.append(f"only the {where} bag has {listed(names)}")
        fields = [field for field in one.fields if field not in other.fields]
        if fields:
            reasons.append(f"only the {where} bag has {', '.join(fields)}")
    if "effort" in a.fields and "effort" in b.fields and a.units["effort"] != b.units["effort"]:
        units = (plain(one.units["effort"]) for one in (a, b))
        reasons.append("effort is in {} in the first bag and in {} in the second, and not compared".format(*units))
    return reasons


def _stamp_reasons(alignment: Alignment, scope: Scope) -> list[str]:
    reasons = []
    for side, where in ((alignment.a, "first"), (alignment.b, "second")):
        if side.missing and side.first_missing_ns is not None:
            reasons.append(
                f"only the {where} bag has {side.missing} messages of the common range, "
                f"the first at t = {side.first_missing_ns / NANOSECONDS:.9f} s"
            )
        if side.outside and not scope.common_range:
            reasons.append(f"only the {where} bag has {side.outside} messages outside the common range")
    return reasons


def _incomparable(topic: str, reason: str) -> TopicComparison:
    return TopicComparison(topic, (), 0, None, None, None, (), (reason,), Verdict.INCOMPARABLE)


def _span(series: JointSeries) -> str:
    stamps = series.stamp_ns
    if not len(stamps):
        return "none"
    return f"{len(stamps)} from {stamps.min() / NANOSECONDS:.9f} to {stamps.max() / NANOSECONDS:.9f} s"


@dataclass(frozen=True, eq=False)
class Alignment:
    """Pairs of rows with equal stamps, in their order; `range_ns` is the stamps' common range, if any."""

    rows_a: NDArray[np.intp]
    rows_b: NDArray[np.intp]
    stamp_ns: Int64Array
    range_ns: tuple[int, int] | None
    a: Side
    b: Side


@dataclass(frozen=True, eq=False)
class _Keyed:
    """The rows of a series that are no repetitions, by stamp, numbered among those with the same stamp."""

    rows: NDArray[np.intp]
    stamp: Int64Array
    occurrence: Int64Array
    repeats: int


def align(a: JointSeries, b: JointSeries) -> Alignment:
    """Pair the messages of two series by stamp.

    Several messages with one stamp: exact repetitions count once; different ones are paired in their order,
    the first with the first and so on.
    """
    keyed_a, keyed_b = _key(a), _key(b)
    rows_a, rows_b = _intersect(keyed_a, keyed_b)
    common = None
    if len(keyed_a.stamp) and len(keyed_b.stamp):
        low = max(int(keyed_a.stamp[0]), int(keyed_b.stamp[0]))
        high = min(int(keyed_a.stamp[-1]), int(keyed_b.stamp[-1]))
        common = (low, high) if low <= high else None
    return Alignment(
        keyed_a.rows[rows_a],
        keyed_b.rows[rows_b],
        keyed_a.stamp[rows_a],
        common,
        _side(keyed_a, rows_a, common),
        _side(keyed_b, rows_b, common),
    )


def _key(series: JointSeries) -> _Keyed:
    rows = np.argsort(series.stamp_ns, kind="stable")
    stamp = series.stamp_ns[rows]
    occurrence = np.zeros(len(rows), dtype=np.int64)
    keep = np.ones(len(rows), dtype=np.bool_)
    again = np.flatnonzero(stamp[1:] == stamp[:-1]) + 1
    seen: dict[bytes, int] = {}
    last = -1
    for i in again.tolist():
        if i - 1 != last:  # a new group begins with the message before
            seen = {_content(series, int(rows[i - 1])): 0}
        last = i
        content = _content(series, int(rows[i]))
        keep[i] = content not in seen
        occurrence[i] = seen.setdefault(content, len(seen))
    return _Keyed(rows[keep], stamp[keep], occurrence[keep], int(len(rows) - keep.sum()))


def _content(series: JointSeries, row: int) -> bytes:
    return b"".join(values[row].tobytes() for values in series.fields.values())


def _intersect(a: _Keyed, b: _Keyed) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    keys_a: NDArray[Any] = a.stamp
    keys_b: NDArray[Any] = b.stamp
    if a.occurrence.any() or b.occurrence.any():
        keys_a, keys_b = _pairs(a), _pairs(b)
    _, rows_a, rows_b = np.intersect1d(keys_a, keys_b, assume_unique=True, return_indices=True)
    return rows_a, rows_b


def _pairs(keyed: _Keyed) -> NDArray[np.void]:
    keys = np.zeros(len(keyed.stamp), dtype=_KEY)
    keys["stamp"], keys["occurrence"] = keyed.stamp, keyed.occurrence
    return keys


def _side(keyed: _Keyed, matched: NDArray[np.intp], common: tuple[int, int] | None) -> Side:
    inside = np.zeros(len(keyed.stamp), dtype=np.bool_)
    if common is not None:
        inside = (keyed.stamp >= common[0]) & (keyed.stamp <= common[1])
    missing = inside.copy()
    missing[matched] = False
    stamps = keyed.stamp[missing]
    return Side(
        missing=len(stamps),
        first_missing_ns=int(stamps[0]) if len(stamps) else None,
        outside=int(len(inside) - inside.sum()),
        repeats=keyed.repeats,
        ambiguous=int((keyed.occurrence > 0).sum()),
    )
