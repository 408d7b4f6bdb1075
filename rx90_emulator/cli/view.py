"""Look at an arm in the browser: move that of running nodes, its laser spot and its friction; or play bags."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.process.children import kill_all
from rx90_common.process.interrupts import ends_within
from rx90_common.process.threads import be_nice, where_threads_are
from rx90_emulator.cli.bag import alignment
from rx90_emulator.cli.options import (
    CONTROLLER,
    add_message_arguments,
    add_page_arguments,
    add_record_arguments,
    add_robot_arguments,
    check_apart,
    check_needs,
    node_of,
    stay_on_this_machine,
    whole_number,
)

if TYPE_CHECKING:
    from rx90_controller.lines.task import TipTask

_PORT, _NICENESS, _MOST_BAGS = 8080, 10, 2
_END_WITHIN = 1.5, 20.0  # s, from Ctrl-C to the end: of a start, of a page that is shown
_OF_BAGS = ("topic", "names", "gear", "coupling", "torque_constant", "zero", "record_time", "signals")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    live = parser.add_argument_group("running nodes")
    live.add_argument("--node", metavar="NAME", help=f"controller node ({CONTROLLER})")
    live.add_argument(
        "--nice", type=whole_number, metavar="N", help=f"niceness: above 0 others come first ({_NICENESS})"
    )
    live.add_argument(
        "--demo", action="store_true",
        help="start simulation and controller, too, and move along the reference line until Ctrl-C",
    )  # fmt: skip
    page = parser.add_argument_group("page")
    add_page_arguments(page, _PORT)
    page.add_argument("--output", type=Path, default=Path(), metavar="FOLDER",
                      help="what is written on the page goes beneath it; made where it is missing (the current "
                      "one)")  # fmt: skip
    parser.set_defaults(host="127.0.0.1", port=_PORT, ros_args=[])
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction", "controller", "task")
    bags = parser.add_argument_group("bags", "what they hold is by default joint_states, else motor_states, as here")
    bags.add_argument("bags", nargs="*", type=Path, metavar="BAG",
                      help="a bag to play in place of running nodes, and a second one as a ghost beside it: folder, "
                      ".mcap, .db3 or ROS 1 .bag file")  # fmt: skip
    bags.add_argument("--align", metavar="start|trajectory|S",
                      help="move the stamps of the second bag: so that both begin together, so that their last "
                      "trajectories do, or by a time in s (0)")  # fmt: skip
    add_message_arguments(bags, "joint_states in any namespace, else motor_states", "as here", "the robot's wrist")
    add_record_arguments(bags)


def main(options: argparse.Namespace) -> None:
    """Show the page until Ctrl-C.

    Raises:
        Rx90Error: where the page cannot be served, the robot or a bag cannot be read, or nodes of its own end.
        KeyboardInterrupt: before the page shows what it was started for; later Ctrl-C is how it ends.
    """
    _check(options)
    with ends_within(*_END_WITHIN, _give_up, _say_where) as start:
        import viser  # noqa: F401 - before kernels are compiled for a page that cannot be made

        from rx90_emulator.view.page import output_folder

        output_folder(options.output)  # refused before bags are read
        try:
            (_play if options.bags else _show_nodes)(options, start.over)
        except KeyboardInterrupt:
            if not start.is_over:
                raise


def _check(options: argparse.Namespace) -> None:
    """Refuse more bags than two, options for bags without any, and for nodes with bags."""
    count = len(options.bags)
    if count > _MOST_BAGS:
        raise BagError(f"{count} bags; accepted: one, or two to be compared")
    if options.align is not None and count < _MOST_BAGS:
        raise BagError(f"--align {plain(options.align)} with {count} bags; accepted: two bags")
    check_needs(options, _OF_BAGS, ("bags",))
    check_apart(options, ("demo", "task", "node", "nice"), "bags", "one of them")


def _give_up() -> None:
    kill_all()
    print("rx90_view: interrupted", file=sys.stderr, flush=True)


def _say_where() -> None:
    kill_all()
    lines = "; ".join(where_threads_are())
    print(f"rx90_view: did not end within {_END_WITHIN[1]:g} s, and was cut off. {lines}", file=sys.stderr, flush=True)


def _play(options: argparse.Namespace, started: Callable[[], None]) -> None:
    """Play bags; `started` is called when the page runs."""
    align = alignment("0" if options.align is None else options.align)
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


def _show_nodes(options: argparse.Namespace, started: Callable[[], None]) -> None:
    """Show running nodes; `started` is called when the page runs, with nodes of its own when their arm is seen."""
    from rx90_common.exchange.ros_start import prepare

    if options.demo:  # a motion that nobody else asked for stays among its own nodes
        stay_on_this_machine()
    prepare()
    from rx90_common.exchange.client_node import client_node
    from rx90_emulator.loop.line import plan_path
    from rx90_emulator.loop.path_file import load_motion
    from rx90_emulator.loop.setup import Setup
    from rx90_emulator.view.live import LiveView
    from rx90_emulator.view.page import Page
    from rx90_emulator.view.panel import DoPanel
    from rx90_emulator.view.plots import add_plot_export
    from rx90_emulator.view.processes import RecordButton, Tour

    files = RobotFiles.of_options(options)
    controller = node_of(options)
    setup = Setup.load(files)
    motion = load_motion(files.required("task")) if options.demo or files.task is not None else None
    line: TipTask | None = motion
    plan = None
    if motion is not None and (options.demo or motion.what == "path"):
        plan = plan_path(setup, motion)
        if motion.what == "path":
            line = plan.task  # which is as slow as the joints require
    tour = Tour(options.robot or DEFAULT_ROBOT, setup, plan, controller) if options.demo and plan is not None else None
    page = Page("rx90_view", options.host, options.port, options.output)
    with ExitStack() as ends:
        if tour is not None:
            ends.callback(tour.end)
        ends.callback(page.close)
        if tour is not None:
            tour.start()
        be_nice(max(os.getpriority(os.PRIO_PROCESS, 0), _NICENESS) if options.nice is None else options.nice)
        with client_node("rx90_view", 1.0, print, options.ros_args) as client:
            view = LiveView(page, client, setup.robot, setup.friction.names, controller, line)
            ends.callback(DoPanel(page, client, setup, line, view.newest, controller, view.lay_line).close)
            with page.tab("Files"):  # once all plots are there
                with page.gui.add_folder("Record a bag"):
                    ends.callback(RecordButton(page, view.watch.namespace, options.ros_args).close)
                with page.gui.add_folder("Export a plot"):
                    add_plot_export(page)
            page.announce(browser=not options.no_browser)
            if tour is None:
                started()
            else:
                tour.follow(page, view, started)
            page.run(check_interrupt=client.check_interrupt)
