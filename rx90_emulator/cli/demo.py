"""Run the reference task with real nodes over DDS, compare, and report."""

from __future__ import annotations

import argparse
from datetime import datetime
from itertools import count
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.exchange.ros_start import prepare
from rx90_emulator.cli.options import (
    add_output,
    add_robot_arguments,
    new_folder,
    stay_on_this_machine,
)

_ANY_PORT = 0  # the demonstration need not know which


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_output(
        parser, new_folder, "folder for bags, logs and report (out/demo/<time>)", metavar="FOLDER"
    )
    parser.add_argument(
        "--short",
        action="store_true",
        help="as fast as the machine allows instead of paced at real time",
    )
    parser.add_argument(
        "--composed",
        action="store_true",
        help="simulation and controller in one process (rx90_cell)",
    )
    parser.add_argument(
        "--view",
        action="store_true",
        help="with a page in the browser that shows the arm (rx90 view)",
    )
    add_robot_arguments(parser, "task")
    parser.set_defaults(interrupted="every process has ended")


def main(options: argparse.Namespace) -> int:
    """Return 0 for a run that is identical to the closed loop and within the path limit, else 1."""
    stay_on_this_machine()
    prepare()
    # Here, because a wrong option must not wait for them.
    from rx90_emulator.demo.demonstration import Demonstration

    files = RobotFiles.of_options(options)
    pace = 0.0 if options.short else 1.0
    page = ["--port", _ANY_PORT] if options.view else None
    demonstration = Demonstration(
        options.robot or DEFAULT_ROBOT, files, pace, options.composed, page
    )
    return 0 if demonstration.run(_folder(options.output)) else 1


def _folder(given: Path | None) -> Path:
    """Make the folder that was asked for, or one with the time as its name that nobody else has."""
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    for k in count(1):
        folder = given or Path("out/demo") / (f"{name}-{k}" if k > 1 else name)
        try:
            folder.mkdir(parents=True)
            (folder / "log").mkdir()
        except OSError as error:
            if isinstance(error, FileExistsError) and given is None and folder.is_dir():
                continue  # another run began in the same second
            raise ConfigError(
                f"--output {folder}: {error.strerror}; accepted: a folder that can be made"
            ) from error
        break
    return folder
