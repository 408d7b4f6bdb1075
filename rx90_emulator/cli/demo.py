"""Run the reference task with real nodes over DDS, compare, and report."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from datetime import datetime
from pathlib import Path

from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.exchange.ros_start import prepare
from rx90_emulator.cli.options import (
    add_output,
    add_robot_arguments,
    new_folder,
    stay_on_this_machine,
)


def add_arguments(parser: ArgumentParser) -> None:
    """Add the command's options."""
    add_output(
        parser, new_folder, "folder for bags, logs and report (out/demo/<time>)", metavar="FOLDER"
    )
    parser.add_argument(
        "--short",
        action="store_true",
        help="as fast as the machine allows instead of paced at real time",
    )
    add_robot_arguments(parser, "task")
    parser.set_defaults(interrupted="every process has ended")


def main(options: Namespace) -> int:
    """Return 0 for a run that is identical to the closed loop and within the path limit, else 1."""
    stay_on_this_machine()
    prepare()
    # Here, because a wrong option must not wait for them.
    from rx90_emulator.demo.demonstration import Demonstration

    files = RobotFiles.of_options(options)
    pace = 0.0 if options.short else 1.0
    demonstration = Demonstration(options.robot or DEFAULT_ROBOT, files, pace)
    folder: Path = options.output or Path("out/demo") / datetime.now().strftime("%Y%m%d-%H%M%S")
    (folder / "log").mkdir(parents=True)
    return 0 if demonstration.run(folder) else 1
