"""Move the tool along a path of lines, arcs and splines, from a path file."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from rx90_emulator.cli.line import add_sending, plan_and_send
from rx90_emulator.cli.options import add_robot_arguments

if TYPE_CHECKING:
    from rx90_common.description.robot import RobotModel
    from rx90_common.description.robot_files import RobotFiles
    from rx90_controller.paths.path import Path

_EPILOG = """\
The path file says where its points come from: itself, a CSV file, G-code or a DXF drawing.
example: rx90_path seam.yaml --approach
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "path", metavar="PATH", help="path file, or the name of a shipped one, such as paths/circle.yaml"
    )
    add_robot_arguments(parser, "urdf", "tool", "controller")
    add_sending(parser)


def main(options: argparse.Namespace) -> None:
    """Plan the path, show it, and send it, except with --dry-run.

    Raises:
        Rx90Error: if the path is refused; as an ExchangeError if it could not be delivered.
    """
    plan_and_send(options, _path)


def _path(options: argparse.Namespace, files: RobotFiles, robot: RobotModel) -> Path:  # noqa: ARG001 - as of a line
    from rx90_emulator.loop.path_file import load_path

    return load_path(options.path)
