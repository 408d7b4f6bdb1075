"""What `rx90_view` shows of running nodes."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from contextlib import ExitStack

from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.process.threads import be_nice
from rx90_emulator.cli.options import CONTROLLER, node_of, whole_number

_NICENESS = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the live view."""
    live = parser.add_argument_group("running nodes")
    live.add_argument("--node", metavar="NAME", help=f"controller node ({CONTROLLER})")
    live.add_argument(
        "--nice", type=whole_number, metavar="N", help=f"niceness: above 0 others come first ({_NICENESS})"
    )
    live.add_argument(
        "--demo", action="store_true",
        help="start simulation and controller, too, and move along the reference line until Ctrl-C",
    )  # fmt: skip


def main(options: argparse.Namespace, started: Callable[[], None]) -> None:
    """Show running nodes until Ctrl-C.

    Args:
        options: of the command.
        started: called when the page runs; with nodes of its own, when their arm is seen.

    Raises:
        Rx90Error: where the page cannot be served, the robot cannot be read, or the demonstration's nodes end.
        KeyboardInterrupt: on Ctrl-C.
    """
    from rx90_common.exchange.ros_start import prepare

    if options.demo:  # before rclpy is imported: a motion that nobody else asked for stays among its own nodes
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    prepare()
    # Here, because --help must not wait for them.
    from rx90_common.description.robot import load_robot
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.lines.task import load_task
    from rx90_emulator.view.live import LiveView
    from rx90_emulator.view.page import Page
    from rx90_emulator.view.panel import DoPanel
    from rx90_emulator.view.plots import add_plot_export
    from rx90_emulator.view.processes import RecordButton, Tour

    files = RobotFiles.of_options(options)
    controller = node_of(options)
    robot = load_robot(files.urdf, files.tool)
    line = None if files.task is None else load_task(files.task)
    shipped = DEFAULT_ROBOT if options.robot is None else options.robot
    tour = Tour(shipped, files, controller) if options.demo else None
    page = Page("rx90_view", options.host, options.port, options.output)
    with ExitStack() as ends:
        if tour is not None:
            ends.callback(tour.end)
        ends.callback(page.close)
        if tour is not None:
            tour.start()
        be_nice(max(os.getpriority(os.PRIO_PROCESS, 0), _NICENESS) if options.nice is None else options.nice)
        with client_node("rx90_view", 1.0, print, options.ros_args) as client:
            view = LiveView(page, client, robot, controller, line)
            ends.callback(DoPanel(page, client, files, view.newest, controller, view.lay_line).close)
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
