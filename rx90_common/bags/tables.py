"""Comparisons and summaries of bags as tables."""

from __future__ import annotations

from rx90_common.bags.comparison import BagComparison, TopicComparison, ValueDifference, Verdict
from rx90_common.bags.summary import BagSummary, TopicSummary
from rx90_common.base.quoting import aligned, counted, listed, plain
from rx90_common.base.rates import NANOSECONDS

_WORDS = {
    Verdict.SAME: "same",
    Verdict.DIFFERS: "DIFFERS",
    Verdict.INCOMPARABLE: "CANNOT BE COMPARED",
}
_COMPARED = (
    "field",
    "joint",
    "max",
    "at t (s)",
    "RMS",
    "unit",
    "tolerance",
    "beyond",
    "not finite",
)
_SUMMARISED = ("topic", "type", "messages", "rate (Hz)", "first (s)", "last (s)", "gaps", "remarks")


def comparison_text(comparison: BagComparison) -> str:
    """Return a table for each topic that is not the same bit for bit, and the verdict in the last line."""
    alike = [topic for topic in comparison.topics if topic.identical]
    blocks = [_topic_text(topic) for topic in comparison.topics if not topic.identical]
    if comparison.shift_ns:
        blocks.insert(
            0,
            f"stamps of {plain(comparison.path_b)} moved by {comparison.shift_ns / NANOSECONDS:+.9f} s",
        )
    verdict = f"{plain(comparison.path_a)} against {plain(comparison.path_b)}: {_WORDS[comparison.verdict]}"
    if alike:
        verdict += f"; {len(alike)} of {counted(len(comparison.topics), 'topic')} bit for bit"
    if len(alike) == len(comparison.topics):
        verdict += f"; {counted(len(comparison.skipped), 'other topic')} not compared"
    elif comparison.skipped:
        blocks.append(f"not compared, as they are no JointState: {listed(comparison.skipped)}")
    return "\n\n".join([*blocks, verdict])


def _topic_text(topic: TopicComparison) -> str:
    lines = [f"{plain(topic.topic)}: {_WORDS[topic.verdict]}"]
    if topic.range_ns is not None:
        low, high = (f"{t / NANOSECONDS:.9g}" for t in topic.range_ns)
        lines[0] += f", {counted(topic.pairs, 'message')} compared, t = {low} to {high} s"
    lines += [f"  {reason}" for reason in topic.reasons]
    rows = [_value_row(value) for value in topic.values if value.maximum or value.beyond]
    return "\n".join([*lines, *(aligned([_COMPARED, *rows]) if rows else [])])


def _value_row(value: ValueDifference) -> tuple[str, ...]:
    return (
        value.field,
        plain(value.joint),
        f"{value.maximum:.3e}",
        _seconds(value.at_ns),
        f"{value.rms:.3e}",
        value.unit,
        f"{value.tolerance:g}",
        f"{value.beyond}",
        f"{value.not_finite}",
    )


def summary_text(summary: BagSummary) -> str:
    """Return a table of the topics below one line about the whole bag."""
    head = f"{plain(summary.path)}: {counted(summary.count, 'message')}"
    return "\n".join([head, *aligned([_SUMMARISED, *map(_topic_row, summary.topics)])])


def _topic_row(topic: TopicSummary) -> tuple[str, ...]:
    remarks = []
    if topic.gaps:
        remarks.append(f"longest gap {_seconds(topic.longest_gap_ns)} s")
    if topic.backward:
        remarks.append(f"time goes back {counted(topic.backward, 'time')}")
    if topic.repeated:
        remarks.append(counted(topic.repeated, "repeated time"))
    if topic.effort_unit:
        remarks.append(f"effort in {topic.effort_unit}")
    return (
        plain(topic.topic),
        plain(topic.msgtype),
        f"{topic.count}",
        "" if topic.rate is None else f"{topic.rate:.3f}",
        _seconds(topic.first_ns),
        _seconds(topic.last_ns),
        f"{topic.gaps}" if topic.gaps else "",
        "; ".join(remarks),
    )


def _seconds(time_ns: int | None) -> str:
    return "" if time_ns is None else f"{time_ns / NANOSECONDS:.6f}"
