"""Look at the arm of running nodes in the browser, its laser spot and its path error, and move it."""

from __future__ import annotations

import threading
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from contextlib import ExitStack

import rx90_emulator as rx
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.process.threads import be_nicer
from rx90_emulator.cli.options import (
    add_node,
    add_robot_arguments,
    stay_on_this_machine,
    whole_from,
)

_NICENESS = 10
_TIMEOUT = 5.0  # s for the answer of a node


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    live = parser.add_argument_group("running nodes")
    add_node(live)
    live.add_argument(
        "--demo", action="store_true",
        help="start simulation and controller, too, and move along the reference line until Ctrl-C",
    )  # fmt: skip
    page = parser.add_argument_group("page")
    page.add_argument("--host", metavar="ADDRESS", default="127.0.0.1",
                      help="to serve the page on; 0.0.0.0 shows it to other machines, too (%(default)s: to this one "
                      "alone)")  # fmt: skip
    page.add_argument(
        "--port",
        type=whole_from(0, 65535),
        default=8080,
        metavar="N",
        help="0: any free one (%(default)s)",
    )
    page.add_argument(
        "--no-browser", action="store_true", help="print the address and open no browser"
    )
    parser.set_defaults(ros_args=[])
    add_robot_arguments(parser, "urdf", "tool", "drives", "friction", "controller", "task")


def main(options: Namespace) -> None:
    """Show the page until Ctrl-C.

    Raises:
        KeyboardInterrupt: before the page shows what it was started for; later Ctrl-C is how it ends.
    """
    import viser  # noqa: F401 - before kernels are compiled for a page that cannot be made

    started = threading.Event()
    try:
        _show_nodes(options, started.set)
    except KeyboardInterrupt:
        if not started.is_set():
            raise


def _show_nodes(options: Namespace, started: Callable[[], None]) -> None:
    """Show running nodes; `started` is called when the page runs, with nodes of its own when their arm is seen."""
    from rx90_common.exchange.ros_start import prepare

    if options.demo:  # a motion that nobody else asked for stays among its own nodes
        stay_on_this_machine()
    prepare()
    from rx90_common.exchange.client_node import client_node
    from rx90_emulator.loop.path_file import load_motion
    from rx90_emulator.view.live import LiveView
    from rx90_emulator.view.page import Page
    from rx90_emulator.view.panel import ControlPanel
    from rx90_emulator.view.tour import Tour

    files = RobotFiles.of_options(options)
    controller = options.node
    setup = rx.Setup.load(files)
    plan = None
    if options.demo or files.task is not None:
        plan = rx.plan_path(setup, load_motion(files.required("task")))
    line = None if plan is None else plan.task  # as slow as the joints require
    tour = (
        Tour(options.robot or DEFAULT_ROBOT, setup, plan, controller)
        if options.demo and plan is not None
        else None
    )
    page = Page("rx90_view", options.host, options.port)
    with ExitStack() as ends:
        if tour is not None:
            ends.callback(tour.end)
        ends.callback(page.close)
        if tour is not None:
            tour.start()
        be_nicer(_NICENESS)
        with client_node("rx90_view", _TIMEOUT, print, options.ros_args) as client:
            view = LiveView(page, client, setup.robot, controller, line)
            panel = ControlPanel(page, client, setup, plan, view.newest, controller)
            print(f"code to move the arm: {panel.lock.code}", flush=True)
            page.announce(browser=not options.no_browser)
            if tour is None:
                started()
            else:
                tour.follow(page, view, started)
            page.run(client.check_interrupt)
