"""Look at an arm in the browser: the arm of running nodes, its laser spot, its friction."""

from __future__ import annotations

import argparse

from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.cli.options import add_robot_arguments

_LAST_PORT = 65535


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.set_defaults(ros_args=[])
    page = parser.add_argument_group("page")
    page.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS",
        help="to serve the page on; 0.0.0.0 shows it to other machines, too (%(default)s: to this one alone)",
    )  # fmt: skip
    page.add_argument("--port", type=_port, default=8080, metavar="N", help="0: any free one (%(default)s)")
    parser.add_argument("--node", default="rx90_controller", metavar="NAME", help="controller node (%(default)s)")
    add_robot_arguments(parser, "urdf", "tool", "task")


def main(options: argparse.Namespace) -> None:
    """Show the page until Ctrl-C.

    Raises:
        Rx90Error: where the page cannot be served or the robot cannot be read.
    """
    from rx90_common.exchange.environment import prepare

    prepare()
    # Here, because --help must not wait for them.
    from rx90_common.description.robot import load_robot
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.lines.task import load_task
    from rx90_emulator.view.live.live_view import LiveView
    from rx90_emulator.view.live.source import LiveSource
    from rx90_emulator.view.page import Page

    files = RobotFiles.of_options(options)
    robot = load_robot(files.urdf, files.tool)
    line = None if files.task is None else load_task(files.task)
    page = Page("rx90_view", options.host, options.port)
    try:
        with client_node("rx90_view", 1.0, print, options.ros_args) as client:
            LiveView(page, LiveSource(client, robot, options.node), robot, line)
            print(f"page: {page.address} (Ctrl-C ends it)", flush=True)
            try:
                page.run()
            except KeyboardInterrupt:
                return
    finally:
        page.close()


def _port(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= _LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text!r}; accepted: a whole number from 0 to {_LAST_PORT}")
    return value
