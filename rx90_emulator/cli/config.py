"""Check configuration files, show what a setup comes to, compare friction, and print the completion for a shell."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError
from rx90_common.base.quoting import one_line, quoted
from rx90_common.base.share import SHIPPED_RIG
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.cli import config_friction
from rx90_emulator.cli.completion import SHELLS, completion
from rx90_emulator.cli.options import CommandParser, add_robot_arguments

if TYPE_CHECKING:
    from rx90_emulator.configuration.origins import ShownValue

_COMPLETION = """
Print the completion of all commands for a shell. To turn it on, put into ~/.bashrc or ~/.zshrc: eval "$(rx90_config
completion bash)", or zsh; that of zsh behind compinit. For fish: rx90_config completion fish | source, in config.fish.
"""
_SHOW = """
Show what a setup of the arm, and the friction rig, come to: each value with its unit, where it comes from (file and
line, command line, default of the code), whether it is assumed, and the sentence that names its source.
"""
_KINDS = "controller, drives, friction, rig, sweep_plan …"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs and their options."""
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    check = verbs.add_parser(
        "check",
        help="say what is wrong in configuration files",
        description="Say what is wrong in configuration files, each problem in a line with key, value and what is "
        "accepted. Exit code 0: nothing; 1: something is; 2: a file is not there, or it cannot be told what it is.",
    )
    check.add_argument("files", nargs="+", type=Path, metavar="FILE",
                       help="YAML file of the project, or a robot folder: its files, and whether they fit "
                       "together")  # fmt: skip
    check.add_argument("--kind", metavar="KIND", help=f"what the files are ({_KINDS}); else told from their keys")
    check.set_defaults(verb=_check)
    about = "show what a setup comes to, and where each value comes from"
    complete = verbs.add_parser(
        "completion", help="print the completion of all commands for a shell", description=_COMPLETION
    )
    complete.add_argument("shell", choices=SHELLS)
    complete.set_defaults(verb=_completion)
    _add_show(verbs.add_parser("show", help=about, description=_SHOW))
    friction = verbs.add_parser("friction", help=config_friction.HELP, description=config_friction.__doc__)
    config_friction.add_arguments(friction)
    friction.set_defaults(verb=config_friction.main)


def _add_show(show: argparse.ArgumentParser) -> None:
    show.set_defaults(verb=_show, ros_args=[])
    add_robot_arguments(show, *FILES)
    show.add_argument("--rig", metavar="FILE", help=f"rig file of the friction rig ({SHIPPED_RIG})")
    about = (
        "what rx90_sim, rx90_controller and friction_bench come to with these, which may also stand behind --ros-args"
    )
    nodes = show.add_argument_group("nodes", about)
    _add_parameters(nodes)
    show.add_argument("--json", action="store_true", help="print JSON instead of a table")


def _add_parameters(group: argparse._ActionsContainer) -> None:
    group.add_argument("--params-file", type=Path, action="append", default=[], metavar="FILE", help="parameter file")
    group.add_argument("-p", "--param", action="append", default=[], metavar="[NODE:]NAME:=VALUE", help="a parameter")
    group.add_argument("--nodes", action="store_true", help="with the nodes' parameters also where none is given")


def main(options: argparse.Namespace) -> int:
    """Run the verb; return its exit code.

    Raises:
        Rx90Error: if it cannot be done.
    """
    code: int = options.verb(options)
    return code


def _check(options: argparse.Namespace) -> int:
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
        raise ConfigError(_together(refused))
    return VERDICT_NO if problems else DONE


def _together(refused: Sequence[str]) -> str:
    """Return refusals as one line, which says once what is accepted instead of several files."""
    by_accepted: dict[str, list[str]] = {}
    for text in refused:
        said, _, accepted = text.partition("; accepted: ")
        by_accepted.setdefault(accepted, []).append(said)
    return "; ".join(f"{'; '.join(said)}; accepted: {accepted}" for accepted, said in by_accepted.items())


def _completion(options: argparse.Namespace) -> int:
    print(completion(options.shell, options.executables))
    return DONE


def _show(options: argparse.Namespace) -> int:
    from rx90_emulator.configuration.showing import values_json, values_table

    if options.ros_args:
        _take_ros_args(options)
    nodes = options.params_file or options.param or options.nodes
    values = _of_nodes(options) if nodes else _of_files(options)
    print(values_json(values) if options.json else values_table(values))
    return DONE


def _take_ros_args(options: argparse.Namespace) -> None:
    """Add what stands behind --ros-args."""
    parser = CommandParser(prog="--ros-args", add_help=False)
    _add_parameters(parser)
    given, other = parser.parse_known_args([word for word in options.ros_args if word != "--ros-args"])
    if other:
        raise ConfigError(f"--ros-args {quoted(other[0])}; accepted: -p and --params-file")
    options.params_file += given.params_file
    options.param += given.param


def _of_nodes(options: argparse.Namespace) -> list[ShownValue]:
    # Here, because it needs ROS.
    from rx90_common.exchange.ros_start import prepare

    prepare()
    from rx90_emulator.configuration.node_values import GivenParameters, node_setup

    named = [role for role in ("robot", *FILES, "rig") if getattr(options, role) is not None]
    if named:
        node = "friction_bench:" * (named[0] == "rig")
        raise ConfigError(f"--{named[0]} with parameters of nodes; accepted: -p {node}{named[0]}:=...")
    return node_setup(GivenParameters.of(options.params_file, options.param))


def _of_files(options: argparse.Namespace) -> list[ShownValue]:
    from rx90_emulator.configuration.origins import COMMAND_LINE, OF_CODE, rig_values, setup_values, steps_value
    from rx90_emulator.loop.setup import Setup

    files = RobotFiles.of_options(options)
    steps = steps_value(Setup.load(files))
    of_robot = f"robot {options.robot}" if options.robot is not None else OF_CODE
    chosen = {role: of_robot if getattr(options, role) is None else COMMAND_LINE for role in FILES}
    rig, origin = (SHIPPED_RIG, OF_CODE) if options.rig is None else (options.rig, COMMAND_LINE)
    return [*setup_values(files, chosen), steps, *rig_values(rig, origin)]
