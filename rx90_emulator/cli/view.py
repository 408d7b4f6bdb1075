"""Look at an arm in the browser: move that of running nodes, its laser spot and its friction; or play bags."""

from __future__ import annotations

import argparse

from rx90_emulator.cli import view_bags, view_live
from rx90_emulator.cli.options import add_robot_arguments

_LAST_PORT = 65535


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(ros_args=[])
    view_live.add_arguments(parser)
    page = parser.add_argument_group("page")
    page.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="to serve the page on; 0.0.0.0 shows it to other machines, too (%(default)s: to this one alone)",
    )  # fmt: skip
    page.add_argument("--port", type=_port, default=8080, metavar="N", help="0: any free one (%(default)s)")
    page.add_argument("--no-browser", action="store_true", help="print the address and open no browser")
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction", "controller", "task")
    view_bags.add_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Show the page until Ctrl-C.

    Raises:
        Rx90Error: where the page cannot be served, or the robot or a bag cannot be read.
    """
    if view_bags.wanted(options):
        view_bags.main(options)
    else:
        view_live.main(options)


def _port(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= _LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text!r}; accepted: a whole number from 0 to {_LAST_PORT}")
    return value
