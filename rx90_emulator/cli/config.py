"""Check configuration files, and show what a setup comes to."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import one_line
from rx90_common.base.share import SHIPPED_RIG
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.cli.options import add_json, add_rig_argument, add_robot_arguments, add_verbs

_KINDS = "controller, drives, friction, rig, sweep_plan …"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    add_verbs(parser, _VERBS)


def _add_check(check: argparse.ArgumentParser) -> None:
    check.add_argument("files", nargs="+", type=Path, metavar="FILE",
                       help="YAML file of the project, or a robot folder: its files, and whether they fit "
                       "together")  # fmt: skip
    check.add_argument(
        "--kind", metavar="KIND", help=f"what the files are ({_KINDS}); else told from their keys"
    )


def _check(options: argparse.Namespace) -> int:
    """Say what is wrong in configuration files, each problem in a line with key, value and what is accepted.

    Exit code 0: nothing; 1: something is; 2: a file is not there, or it cannot be told what it is.
    """
    from rx90_emulator.configuration.check import check_path, kind_named

    kind = None if options.kind is None else kind_named(options.kind)
    problems = 0
    refused: list[str] = []
    for path in options.files:
        try:
            checked = check_path(path, kind)
        except ConfigError as error:  # the files behind it are checked first
            refused.append(str(error))
            continue
        for one in checked:
            problems += len(one.problems)
            print("\n".join(one.problems) or one_line(f"{one.path}: {one.kind}, no problem"))
    if refused:
        # One line, which says once what is accepted instead of several files.
        by_accepted: dict[str, list[str]] = {}
        for text in refused:
            fault, _, accepted = text.partition("; accepted: ")
            by_accepted.setdefault(accepted, []).append(fault)
        raise ConfigError(
            "; ".join(
                f"{'; '.join(faults)}; accepted: {one}" for one, faults in by_accepted.items()
            )
        )
    return VERDICT_NO if problems else DONE


def _add_show(show: argparse.ArgumentParser) -> None:
    add_robot_arguments(show, *FILES)
    add_rig_argument(show)
    add_json(show)


def _show(options: argparse.Namespace) -> int:
    """Show what a setup of the arm, and the friction rig, come to.

    Each value with its unit, where it comes from (file and line, command line, default of the code), whether it is
    assumed, and the sentence that names its source.
    """
    from rx90_emulator.configuration.origins import (
        COMMAND_LINE,
        OF_CODE,
        rig_values,
        setup_values,
        steps_value,
        values_json,
        values_table,
    )
    from rx90_emulator.loop.setup import Setup

    files = RobotFiles.of_options(options)
    steps = steps_value(Setup.load(files))
    of_robot = f"robot {options.robot}" if options.robot is not None else OF_CODE
    chosen = {role: of_robot if getattr(options, role) is None else COMMAND_LINE for role in FILES}
    origin = OF_CODE if options.rig == SHIPPED_RIG else COMMAND_LINE
    values = [*setup_values(files, chosen), steps, *rig_values(options.rig, origin)]
    print(values_json(values) if options.json else values_table(values))
    return DONE


_VERBS = (
    (_add_check, _check, "say what is wrong in configuration files"),
    (_add_show, _show, "show what a setup comes to, and where each value comes from"),
)
