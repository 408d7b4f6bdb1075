"""Record, compare, draw, export, import and summarise bags."""

from __future__ import annotations

import argparse

from rx90_emulator.cli import bag_compare, bag_export, bag_import, bag_plot, bag_record

_VERBS = {
    "record": bag_record,
    "compare": bag_compare,
    "plot": bag_plot,
    "export": bag_export,
    "import": bag_import,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a parser for each verb."""
    parser.set_defaults(ros_args=[])  # `ros2 run` and launch files append them
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, verb in _VERBS.items():
        one = verbs.add_parser(name, help=verb.HELP, description=verb.__doc__)
        verb.add_arguments(one)
        one.set_defaults(run=verb.main)
    about = "Summarise a bag: topics, counts, rates, times, and gaps between stamps."
    info = verbs.add_parser("info", help="summarise a bag", description=about)
    info.add_argument("bag", metavar="BAG", help="bag: folder, .mcap, .db3 or ROS 1 .bag file")
    info.add_argument("--json", action="store_true", help="print JSON instead of a table")
    info.set_defaults(run=_info)


def main(options: argparse.Namespace) -> int | None:
    """Run the verb; return its exit code.

    Raises:
        Rx90Error: if it cannot be done.
    """
    code: int | None = options.run(options)
    return code


def _info(options: argparse.Namespace) -> None:
    # Here, because --help must not wait for them.
    from rx90_common.bags.summary import summarise
    from rx90_common.bags.tables import summary_json, summary_text

    summary = summarise(options.bag)
    print(summary_json(summary) if options.json else summary_text(summary))
