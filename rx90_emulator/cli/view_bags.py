"""What `rx90_view` plays of bags."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_emulator.cli.bag import alignment
from rx90_emulator.cli.options import add_message_arguments, add_record_arguments

_MOST = 2
_OF_BAGS = ("topic", "names", "gear", "coupling", "torque_constant", "zero", "record_time", "signals")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bags, and the options that say what their messages hold."""
    bags = parser.add_argument_group("bags", "what they hold is by default joint_states, else motor_states, as here")
    bags.add_argument("bags", nargs="*", type=Path, metavar="BAG",
                      help="a bag to play in place of running nodes, and a second one as a ghost beside it: folder, "
                      ".mcap, .db3 or ROS 1 .bag file")  # fmt: skip
    bags.add_argument("--align", metavar="start|trajectory|S",
                      help="move the stamps of the second bag: so that both begin together, so that their last "
                      "trajectories do, or by a time in s (0)")  # fmt: skip
    add_message_arguments(bags, "joint_states in any namespace, else motor_states", "as here", "the robot's wrist")
    add_record_arguments(bags)


def wanted(options: argparse.Namespace) -> bool:
    """Return whether bags are to be played.

    Raises:
        BagError: for more bags than two, options for bags without any, and for nodes with bags.
    """
    count = len(options.bags)
    if count > _MOST:
        raise BagError(f"{count} bags; accepted: one, or two to be compared")
    if options.align is not None and count < _MOST:
        raise BagError(f"--align {plain(options.align)} with {count} bags; accepted: two bags")
    given = [name for name in _OF_BAGS if getattr(options, name)]
    if given and not count:
        raise BagError(f"--{given[0].replace('_', '-')} without a bag; accepted: with one, to be played")
    asked = {"demo": options.demo, "node": options.node is not None, "nice": options.nice is not None}
    of_nodes = [name for name, there in asked.items() if there]
    if count and of_nodes:
        raise BagError(f"--{of_nodes[0]} with the bag {plain(options.bags[0])}; accepted: one of them")
    return count > 0


def main(options: argparse.Namespace, started: Callable[[], None]) -> None:
    """Show the page until Ctrl-C.

    Args:
        options: of the command.
        started: called when the page runs.

    Raises:
        Rx90Error: where the page cannot be served, or the robot or a bag cannot be read.
        KeyboardInterrupt: on Ctrl-C.
    """
    align = alignment("0" if options.align is None else options.align)
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.identification.options import MeasuredLayout
    from rx90_emulator.view.page import Page
    from rx90_emulator.view.player import open_player

    layout = MeasuredLayout(**{name: getattr(options, name) for name in _OF_BAGS})
    page, _ = open_player(
        lambda: Page("rx90_view", options.host, options.port, options.output), options.bags,
        RobotFiles.of_options(options), layout, align,
    )  # fmt: skip
    try:
        page.announce(browser=not options.no_browser)
        started()
        page.run()
    finally:
        page.close()
