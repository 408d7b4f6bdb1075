"""The monitor of V+ on a serial line: the emulated arm for programs that talk to the cabinet's own prompt."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_emulator.cli.options import add_robot_arguments, whole_from

_EPILOG = """\
Without --port the line is a pseudo-terminal, whose name is printed; Ctrl-C ends. docs/reference/vplus.md has the
commands. The arm moves on the wall clock, in the closed loop without ROS.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="programs and locations that were not stored are gone")
    parser.add_argument("--port", type=whole_from(0, 65535), metavar="N", help="TCP port of 127.0.0.1; 0: any free one")
    parser.add_argument("--folder", type=Path, default=Path(), help="where LOAD and STORE find files (the present one)")
    add_robot_arguments(parser)


def main(options: argparse.Namespace) -> None:
    """Serve the monitor until Ctrl-C."""
    # Here, because --help must not wait for them.
    from rx90_common.description.robot_files import RobotFiles
    from rx90_emulator.loop.setup import Setup
    from rx90_emulator.vplus.serving import serve

    setup = Setup.load(RobotFiles.of_options(options))
    serve(setup, options.folder, options.port, lambda line: print(f"monitor of V+ on {line}", flush=True))
