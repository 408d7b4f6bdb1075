"""Check configuration files, and show what a setup comes to."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import one_line
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.cli.options import add_rig_argument, add_robot_arguments

_KINDS = "controller, drives, friction, rig, sweep_plan …"


def _add_check(check: ArgumentParser) -> None:
    check.add_argument("files", nargs="+", type=Path, metavar="FILE",
                       help="YAML file of the project, or a robot folder: its files, and whether they fit "
                       "together")  # fmt: skip
    check.add_argument(
        "--kind", metavar="KIND", help=f"what the files are ({_KINDS}); else told from their keys"
    )


def _check(options: Namespace) -> int:
    """Say what is wrong in configuration files, each problem in a line with key, value and what is accepted.

    Exit code 0: nothing; 1: something is; 2: a file is not there, or it cannot be told what it is.
    """
    from rx90_emulator.configuration.check import check_path, kind_named

    kind = None if options.kind is None else kind_named(options.kind)
    verdict = DONE
    refused: list[str] = []
    for path in options.files:
        try:
            files = check_path(path, kind)
        except ConfigError as error:  # the files behind it are checked first
            refused.append(str(error))
            continue
        for file in files:
            print("\n".join(file.problems) or one_line(f"{file.path}: {file.kind}, no problem"))
            if file.problems:
                verdict = VERDICT_NO
    if refused:
        raise ConfigError("; ".join(refused))
    return verdict


def _add_show(show: ArgumentParser) -> None:
    add_robot_arguments(show, *FILES)
    add_rig_argument(show)


def _show(options: Namespace) -> int:
    """Show what a setup of the arm, and the friction rig, come to.

    Each value with its unit, where it comes from (file and line, or default of the code), whether it is
    assumed, and the sentence that names its source.
    """
    from rx90_emulator.configuration import origins

    values = origins.robot_values(RobotFiles.of_options(options))
    values += origins.rig_values(options.rig)
    print(origins.values_table(values))
    return DONE


SUBCOMMANDS = (
    (_add_check, _check, "say what is wrong in configuration files"),
    (_add_show, _show, "show what a setup comes to, and where each value comes from"),
)
