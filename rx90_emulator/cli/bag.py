"""Record, compare and summarise bags."""

from __future__ import annotations

import argparse

from rx90_emulator.cli import bag_compare, bag_info, bag_record


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a parser for each verb."""
    parser.set_defaults(ros_args=[])  # `ros2 run` and launch files append them
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, verb in (("record", bag_record), ("compare", bag_compare), ("info", bag_info)):
        one = verbs.add_parser(name, help=verb.HELP, description=verb.__doc__)
        verb.add_arguments(one)
        one.set_defaults(run=verb.main)


def main(options: argparse.Namespace) -> int | None:
    """Run the verb; return its exit code.

    Raises:
        Rx90Error: if it cannot be done.
    """
    code: int | None = options.run(options)
    return code
