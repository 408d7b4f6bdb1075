"""Tell what a bag holds: topics, counts, rates, times, and gaps between stamps."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from rx90_common.bags.table import table
from rx90_common.base.rates import NANOSECONDS

if TYPE_CHECKING:
    from rx90_common.bags.summary import BagSummary, TopicSummary

HELP = "tell what a bag holds"

_HEADINGS = ("topic", "type", "messages", "rate (Hz)", "first (s)", "last (s)", "gaps", "remarks")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def main(args: argparse.Namespace, _ros_args: Sequence[str]) -> int:
    """Print the summary; return 0.

    Raises:
        BagError: if the bag cannot be read.
    """
    from rx90_common.bags.summary import summarise  # here, because --help must not wait for it

    summary = summarise(args.bag)
    print(_as_json(summary) if args.json else _as_text(summary))
    return 0


def _as_json(summary: BagSummary) -> str:
    content = asdict(summary) | {"path": str(summary.path), "count": summary.count}
    return json.dumps(content, indent=2, allow_nan=False)


def _as_text(summary: BagSummary) -> str:
    head = f"{summary.path}: {summary.storage}, {summary.size / 1e6:.1f} MB, {summary.count} messages"
    return f"{head}\n{table(_HEADINGS, [_row(topic) for topic in summary.topics])}"


def _row(topic: TopicSummary) -> tuple[str, ...]:
    return (
        topic.topic,
        topic.msgtype,
        f"{topic.count}",
        "" if topic.rate is None else f"{topic.rate:.3f}",
        _seconds(topic.first_ns),
        _seconds(topic.last_ns),
        f"{topic.gaps}" if topic.gaps else "",
        _remarks(topic),
    )


def _remarks(topic: TopicSummary) -> str:
    remarks = []
    if topic.longest_gap_ns is not None:
        where = _seconds(topic.longest_gap_at_ns)
        remarks.append(f"longest gap {topic.longest_gap_ns / NANOSECONDS:.6f} s after t = {where} s")
    if topic.backward:
        remarks.append(f"time goes back {topic.backward} times")
    if topic.repeated:
        remarks.append(f"{topic.repeated} repeated times")
    if topic.time == "log" and topic.count:
        remarks.append("by log time")
    return "; ".join(remarks)


def _seconds(time_ns: int | None) -> str:
    return "" if time_ns is None else f"{time_ns / NANOSECONDS:.6f}"
