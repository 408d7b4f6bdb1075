"""Summarise a bag: topics, counts, rates, times, and gaps between stamps."""

from __future__ import annotations

import argparse

HELP = "summarise a bag"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    parser.add_argument("bag", metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def main(args: argparse.Namespace) -> None:
    """Print the summary.

    Raises:
        BagError: if the bag cannot be read.
    """
    # Here, because --help must not wait for them.
    from rx90_common.bags.summary import summarise
    from rx90_common.bags.tables import summary_json, summary_text

    summary = summarise(args.bag)
    print(summary_json(summary) if args.json else summary_text(summary))
