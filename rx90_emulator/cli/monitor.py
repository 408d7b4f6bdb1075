"""The monitor of V+ on a serial line: the emulated arm for programs that talk to the cabinet's own prompt."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_emulator.cli.options import CONTROLLER, add_robot_arguments, whole_from

if TYPE_CHECKING:
    from rx90_emulator.loop.setup import Setup
    from rx90_emulator.vplus.cell import Cell

_EPILOG = """\
Without --port the line is a pseudo-terminal, whose name is printed; Ctrl-C ends. docs/reference/vplus.md has the
commands. The arm moves on the wall clock, in the closed loop without ROS, or in running nodes.
"""
_TIMEOUT = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="programs and locations that were not stored are gone", ros_args=[])
    parser.add_argument("--port", type=whole_from(0, 65535), metavar="N", help="TCP port of 127.0.0.1; 0: any free one")
    parser.add_argument("--folder", type=Path, default=Path(), help="where LOAD and STORE find files (the present one)")
    parser.add_argument("--baud", type=whole_from(300, 115200), metavar="N", help="pace of the line, 8N1 (none)")
    parser.add_argument(
        "--nodes",
        nargs="?",
        const=CONTROLLER,
        metavar="NAME",
        help=f"use the arm of a running controller ({CONTROLLER})",
    )
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Serve the monitor until Ctrl-C."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.loop.setup import Setup
    from rx90_emulator.vplus.cell import Cell, Engine

    setup = Setup.load(RobotFiles.of_options(options))
    if options.nodes is not None:
        _serve_on_nodes(options, setup)
    else:
        _serve(options, Cell(setup, Engine(setup, keep=False)))


def _serve(options: argparse.Namespace, cell: Cell) -> None:
    from rx90_emulator.vplus.monitor import serve

    serve(cell, options.folder, _announce, options.port, options.baud, waits=options.nodes is None)


def _announce(line: str) -> None:
    print(f"monitor of V+ on {line}", flush=True)


def _serve_on_nodes(options: argparse.Namespace, setup: Setup) -> None:
    from rx90_common.exchange.ros_start import prepare

    prepare()
    from rx90_common.exchange.client_node import client_node
    from rx90_controller.node.program_client import ProgramClient
    from rx90_emulator.vplus.cell import Cell

    with client_node("rx90_monitor", _TIMEOUT, print, options.ros_args) as client:
        nodes = ProgramClient(client, options.nodes, setup.robot.joint_names)
        cell = Cell(setup, nodes)
        cell.publish = nodes.signals(cell.receive)
        _serve(options, cell)
