"""A comparison of two bags as text for a person and as JSON for a program."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import groupby
from typing import Any

from rx90_common.bags.alignment import Side
from rx90_common.bags.comparison import BagComparison, TopicComparison, ValueDifference, Verdict
from rx90_common.bags.table import table
from rx90_common.bags.topics import UNITS
from rx90_common.base.rates import NANOSECONDS

_WORDS = {
    Verdict.SAME: "same",
    Verdict.DIFFERS: "DIFFERS",
    Verdict.INCOMPARABLE: "CANNOT BE COMPARED",
}
_HEADINGS = ("field", "joint", "max", "at t (s)", "RMS", "unit", "tolerance", "beyond")


def as_text(comparison: BagComparison) -> str:
    """Return a table of the differences, topic by topic, and the verdict in the last line."""
    blocks = [_topic_text(topic) for topic in comparison.topics]
    if comparison.skipped:
        blocks.append(f"not compared, as they are no JointState: {', '.join(comparison.skipped)}")
    blocks.append(f"{comparison.path_a} against {comparison.path_b}: {_WORDS[comparison.verdict]}")
    return "\n\n".join(blocks)


def as_json(comparison: BagComparison) -> str:
    """Return all figures as JSON: stamps in ns, values in rad, rad/s and Nm."""
    content = {
        "a": str(comparison.path_a),
        "b": str(comparison.path_b),
        "verdict": comparison.verdict.name.lower(),
        "exit_code": int(comparison.verdict),
        "topics": [_topic_dict(topic) for topic in comparison.topics],
        "not_compared": list(comparison.skipped),
    }
    return json.dumps(content, indent=2, allow_nan=False)


def _topic_dict(topic: TopicComparison) -> dict[str, Any]:
    content = asdict(topic)
    content["verdict"] = topic.verdict.name.lower()
    for value in content["values"]:
        value["unit"] = UNITS[value["field"]]
    return content


def _topic_text(topic: TopicComparison) -> str:
    lines = [f"{topic.topic}: {_WORDS[topic.verdict]}"]
    if topic.range_ns is not None:
        low, high = (f"{t / NANOSECONDS:.9g}" for t in topic.range_ns)
        lines[0] += f", {topic.pairs} messages compared, t = {low} to {high} s"
    lines += [f"  {reason}" for reason in topic.reasons]
    for side, where in ((topic.a, "first"), (topic.b, "second")):
        if side is not None and (note := _side_note(side)):
            lines.append(f"  {where} bag: {note}")
    rows = [row for _, values in groupby(topic.values, lambda v: v.field) for row in _field_rows(list(values))]
    if rows:
        lines.append(table(_HEADINGS, rows, indent=2))
    return "\n".join(lines)


def _side_note(side: Side) -> str:
    parts = [
        (side.outside, "messages outside the common range"),
        (side.repeats, "exact repetitions, counted once"),
        (side.ambiguous, "messages that share a stamp with another one"),
    ]
    return "; ".join(f"{count} {what}" for count, what in parts if count)


def _field_rows(values: list[ValueDifference]) -> list[tuple[str, ...]]:
    """Return one row per joint; one for all when none of them differs at all."""
    first = values[0]
    if len(values) > 1 and all(v.maximum == 0.0 and not v.beyond for v in values):
        tolerances = {v.tolerance for v in values}
        tolerance = f"{first.tolerance:g}" if len(tolerances) == 1 else "various"
        return [(first.field, f"all {len(values)}", "0", "", "0", UNITS[first.field], tolerance, "")]
    return [_row(value) for value in values]


def _row(value: ValueDifference) -> tuple[str, ...]:
    beyond = f"{value.beyond}" if value.beyond else ""
    if value.not_finite:
        beyond += f" ({value.not_finite} not finite)"
    return (
        value.field,
        value.joint,
        f"{value.maximum:.3e}" if value.maximum else "0",
        "" if value.at_ns is None else f"{value.at_ns / NANOSECONDS:.6f}",
        f"{value.rms:.3e}" if value.rms else "0",
        UNITS[value.field],
        f"{value.tolerance:g}",
        beyond,
    )
