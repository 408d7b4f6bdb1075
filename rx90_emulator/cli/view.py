"""Look at an arm in the browser: move that of running nodes, its laser spot and its friction; or play bags."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rx90_common.process.children import kill_all
from rx90_common.process.interrupts import ends_within
from rx90_common.process.threads import where_threads_are
from rx90_emulator.cli import view_bags, view_live
from rx90_emulator.cli.options import add_page_arguments, add_robot_arguments

_PORT = 8080
_PATIENCE = 1.5, 20.0  # s, from Ctrl-C to the end: of a start, of a page that is shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(ros_args=[])
    view_live.add_arguments(parser)
    page = parser.add_argument_group("page")
    add_page_arguments(page, _PORT)
    page.add_argument("--output", type=Path, default=Path(), metavar="FOLDER",
                      help="what is written on the page goes beneath it; made where it is missing (the current "
                      "one)")  # fmt: skip
    parser.set_defaults(host="127.0.0.1", port=_PORT)
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction", "controller", "task")
    view_bags.add_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Show the page until Ctrl-C.

    Raises:
        Rx90Error: where the page cannot be served, or the robot or a bag cannot be read.
        KeyboardInterrupt: before the page shows what it was started for; later Ctrl-C is how it ends.
    """
    of_bags = view_bags.wanted(options)
    with ends_within(*_PATIENCE, _give_up, _say_where) as start:
        import viser  # noqa: F401 - before kernels are compiled for a page that cannot be made

        from rx90_emulator.view.page import output_folder

        output_folder(options.output)  # refused before bags are read
        try:
            (view_bags if of_bags else view_live).main(options, start.over)
        except KeyboardInterrupt:
            if not start.is_over:
                raise


def _give_up() -> None:
    kill_all()
    print("rx90_view: interrupted", file=sys.stderr, flush=True)


def _say_where() -> None:
    kill_all()
    lines = "; ".join(where_threads_are())
    print(f"rx90_view: did not end within {_PATIENCE[1]:g} s, and was cut off. {lines}", file=sys.stderr, flush=True)
