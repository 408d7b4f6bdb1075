"""The parser of every command, the options that several of them have, and their progress bar."""

from __future__ import annotations

import argparse
import inspect
import math
import os
import re
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import rx90_emulator as rx
from rx90_common.base.errors import REFUSED, ConfigError, check_bag_name, check_place
from rx90_common.base.quoting import one_line, plain, quoted
from rx90_common.base.share import SHIPPED_RIG
from rx90_common.description.robot_files import (
    DEFAULT_ROBOT,
    DESCRIPTIONS,
    FILES,
    MODEL_FILES,
    PAPER,
    RobotFiles,
    shipped_robots,
)

_EXIT_CODES = """
exit status: 0 done, also after Ctrl-C for what runs until then (nodes, recorder, emulated rig); 1 done, and the verdict
is no (bags differ, messages lost, not confirmed); 2 refused, nothing was written; 3 could not be carried out (nodes
gone, disk full); 130 interrupted; 141 the reader of the output has gone.
"""
_NEGATIVE = re.compile(r"-((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf|infinity|nan)$", re.IGNORECASE)
_BAR = "{desc}: {percentage:3.0f} % |{bar}| [{elapsed}<{remaining}]"
CONTROLLER = "rx90_controller"
"""Name of the controller node, unless another one is given."""
URDF = "its URDF with <inertial>, no xacro"
_JOINTS = (
    "the URDF's joints of interest from base to tip; the others are held at 0 (all movable ones)"
)


class CommandParser(ArgumentParser):
    """A parser whose help, also that of each verb, ends with what the exit codes mean.

    A word such as -1e-3 is a number; argparse alone takes it for an option, and says that the number is missing.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._negative_number_matcher = _NEGATIVE

    def format_help(self) -> str:
        """Return the help."""
        return super().format_help() + _EXIT_CODES

    def error(self, message: str) -> NoReturn:
        """Refuse the command line in one line; words of it are quoted in the message as they are."""
        self.exit(
            REFUSED, f"{self.prog}: {one_line(message)}; {self.prog} --help says what is accepted\n"
        )


def command_of(name: str) -> tuple[CommandParser, Callable[[Any], int | None]]:
    """Return the parser of a command, an executable or `rx90 VERB`, with its options, and what runs it."""
    module = module_of(name)
    parser = CommandParser(prog=name, description=inspect.getdoc(module))
    add_options(parser, module)
    return parser, getattr(module, "main", _run_verb)


def add_options(parser: ArgumentParser, module: ModuleType) -> None:
    """Add the options of a command's module: those of its `SUBCOMMANDS`, or what its `add_arguments` adds."""
    if hasattr(module, "SUBCOMMANDS"):
        add_verbs(parser, module.SUBCOMMANDS)
    else:
        module.add_arguments(parser)


def module_of(name: str) -> ModuleType:
    """Return the module of a command."""
    file = name.removeprefix("rx90 ") if name.startswith("rx90 ") else "node"
    return import_module(f"rx90_emulator.cli.{file}")


def _run_verb(options: Any) -> int | None:
    """Run the verb that `add_verbs` has left in the options."""
    return options.run(options)  # type: ignore[no-any-return]


def split_ros_args(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Separate a command's own arguments from those for ROS: from --ros-args, which is kept, to -- or the end."""
    own: list[str] = []
    ros: list[str] = []
    target = own
    for word in words:
        if word == "--ros-args":
            target = ros
        elif word == "--" and target is ros:
            target = own
            continue
        target.append(word)
    return own, ros


def number(
    accepted: str, good: Callable[[float], bool] = lambda _: True, kind: type[float] = float
) -> Callable[[str], float]:
    """Return a type for argparse: finite numbers for which `good` holds; argparse itself does not say what is accepted.

    Args:
        accepted: what is, in words, for the refusal.
        good: which finite numbers are.
        kind: `int` for whole numbers.
    """

    def parse(text: str) -> float:
        try:
            if math.isfinite(value := kind(text)) and good(value):
                return value
        except (ValueError, OverflowError):
            pass
        raise argparse.ArgumentTypeError(f"{quoted(text)}; accepted: {accepted}")

    return parse


_NOT_ZERO = number("a finite number other than 0", lambda value: value != 0.0)
FINITE = number("a finite number")
POSITIVE = number("a positive number", lambda value: value > 0.0)
whole_number = number("a whole number", kind=int)


def whole_from(low: int, high: int) -> Callable[[str], float]:
    """Return a type for argparse: whole numbers from the one to the other."""
    return number(f"a whole number from {low} to {high}", lambda value: low <= value <= high, int)


def place(text: str) -> Path:
    """Return the path of a file to be written, as a type for argparse: refused at once if it cannot be written."""
    path = Path(text)
    if not path.absolute().parent.exists():
        raise ConfigError(
            f"{plain(path)}: the folder {plain(path.parent)} does not exist; accepted: one that does"
        )
    check_place(path)
    return path


def new_file(text: str) -> Path:
    """Return the path of a file to be made, as a type for argparse: as `place`, and refused if it exists."""
    _check_new(text)
    return place(text)


def new_folder(text: str) -> Path:
    """Return the path of a folder to be made, with the folders above it, as a type for argparse."""
    _check_new(text)
    check_bag_name(Path(text))
    check_place(Path(text))
    return Path(text)


def _check_new(text: str) -> None:
    if os.path.lexists(text):
        raise ConfigError(f"{plain(text)} exists; accepted: a new name")


def check_picture(path: Path) -> None:
    """Refuse a picture of another format than Matplotlib is asked for."""
    from rx90_common.report.style import PICTURES

    if path.suffix.lower() not in PICTURES:
        raise ConfigError(f"--plot {plain(path)}; accepted: a file with {', '.join(PICTURES)}")


def stay_on_this_machine() -> None:
    """Keep ROS, before it is imported, on this machine and apart from other runs on it, unless the user says where."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))


def setup_of(options: Namespace) -> rx.Setup:
    """Return the setup of the robot, and of the single files of it, that the options name."""
    return rx.Setup.load(RobotFiles.of_options(options))


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[float, float], None]]:
    """Yield a callback for progress, called with what is done and the total; after a second it shows a bar."""
    from tqdm import tqdm

    with tqdm(desc=what, bar_format=_BAR, delay=1.0, disable=None, file=sys.stderr) as bar:

        def show(done: float, total: float) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


def add_output(
    parser: argparse._ActionsContainer, kind: Callable[[str], Path], text: str, **more: Any
) -> None:
    """Add --output, what a command writes: a `place`, a `new_file` or a `new_folder`."""
    parser.add_argument("-o", "--output", type=kind, help=text, **more)


def add_force(parser: ArgumentParser) -> None:
    """Add --force, by which what a command writes may replace files."""
    parser.add_argument("--force", action="store_true", help="replace files that exist")


def add_slow_only(parser: ArgumentParser) -> None:
    """Add --slow-only, without which what is written holds the topics of the base rate, too."""
    parser.add_argument(
        "--slow-only", action="store_true", help="leave the two 4 kHz topics out of what is written"
    )


def add_rate(parser: argparse._ActionsContainer) -> None:
    """Add --rate, of set-points."""
    parser.add_argument(
        "--rate",
        type=POSITIVE,
        default=1000.0,
        metavar="HZ",
        help="of the set-points, Hz (%(default)g)",
    )


def add_start_time(parser: argparse._ActionsContainer, default: str) -> None:
    """Add --start-time, of a motion."""
    parser.add_argument(
        "--start-time",
        type=FINITE,
        default=0.0,
        metavar="S",
        help=f"when the motion starts, s ({default})",
    )


def add_rig_argument(parser: ArgumentParser) -> None:
    """Add --rig, the file of a friction rig."""
    parser.add_argument("--rig", default=SHIPPED_RIG, metavar="FILE", help="rig file (%(default)s)")


Verb = tuple[Callable[[ArgumentParser], None], Callable[[Namespace], int | None], str]
"""A verb of a command: the function that adds its arguments; the function that runs it, whose name is the verb and
whose docstring is the description; its line in --help."""


def add_verbs(parser: ArgumentParser, verbs: Sequence[Verb]) -> None:
    """Add a parser for each verb, whose function `options.run` then is."""
    added = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for add, run, text in verbs:
        one = added.add_parser(run.__name__.strip("_"), help=text, description=inspect.getdoc(run))
        one.set_defaults(run=run)
        add(one)


def add_robot_argument(parser: argparse._ActionsContainer) -> None:
    """Add --robot, which names all files of a robot."""
    parser.add_argument("--robot", metavar="ROBOT",
                        help=f"{', '.join(shipped_robots())}, or your own robot folder ({DEFAULT_ROBOT}; {PAPER} has "
                        "the paper's literal choices)")  # fmt: skip


def add_robot_arguments(parser: ArgumentParser, *names: str) -> None:
    """Add --robot, and the options that name single files of it, by default the model's; `RobotFiles.of_options`."""
    robot = parser.add_argument_group(
        "robot", "a robot folder, and single files instead of those in it"
    )
    add_robot_argument(robot)
    for name in names or MODEL_FILES:
        robot.add_argument(
            f"--{name}", metavar="FILE", help=f"{DESCRIPTIONS[name]} (the robot's {FILES[name]})"
        )


def add_node(group: argparse._ActionsContainer) -> None:
    """Add --node, the controller that a command talks to."""
    group.add_argument(
        "--node", metavar="NAME", default=CONTROLLER, help="controller node (%(default)s)"
    )


def add_node_arguments(group: argparse._ActionsContainer, timeout: float = 30.0) -> None:
    """Add the options of a command that talks to running nodes."""
    add_node(group)
    about = f"s to wait for the nodes ({timeout:g})"
    group.add_argument("--timeout", type=POSITIVE, default=timeout, metavar="S", help=about)


def add_arm_arguments(parser: ArgumentParser) -> None:
    """Add the options that describe the arm that bags were recorded of: this project's robot, or any other."""
    add_robot_arguments(parser, "tool", "drives")
    either = parser.add_argument_group("any robot")
    either.add_argument("--fallback", metavar="FILE",
                        help="friction file for omega_d and for parameters that are not identifiable, or none (shipped "
                        "for this project's robot, none for another)")  # fmt: skip
    add_zero_argument(either)
    other = parser.add_argument_group(
        "another robot", "n is the number of joints; lists follow --joints. SI units, and gravity along -z of the "
        "URDF's root link."
    )  # fmt: skip
    other.add_argument(
        "--urdf", type=Path, metavar="FILE", help=f"{URDF}; turns the options of this group on"
    )
    add_joints_argument(other)
    add_message_arguments(other)
    other.add_argument("--rotor-inertia", nargs="+", metavar="J",
                       type=number("0 or a positive number", lambda value: value >= 0.0),
                       help="of each motor, seen through its gear (times its square), kg m^2 (0)")  # fmt: skip


def add_joints_argument(group: argparse._ActionsContainer, text: str = _JOINTS) -> None:
    """Add --joints, by default those of a URDF."""
    group.add_argument("--joints", nargs="+", metavar="NAME", help=text)


def add_signals_argument(group: argparse._ActionsContainer, text: str) -> None:
    """Add --signals, the signal map of messages and tables."""
    group.add_argument(
        "--signals",
        type=Path,
        metavar="FILE",
        help=f"signal map, YAML: {text} (the file named as the table, with .yaml)",
    )


def add_zero_argument(group: argparse._ActionsContainer) -> None:
    """Add the option of the encoders' zeros, of any robot."""
    group.add_argument("--zero", nargs="+", type=FINITE, metavar="RAD",
                       help="what the encoder of each joint says where its angle in the URDF is 0, which is "
                       "subtracted, rad (0)")  # fmt: skip


def add_message_arguments(group: argparse._ActionsContainer, topic: str = "joint_states") -> None:
    """Add the options that say what JointState messages hold, by default of a topic."""
    add_signals_argument(group, "the same as these options and more (names in the messages, coupled motors, springs, "
                         "times), and what the columns of a CSV, Parquet or NPZ table hold")  # fmt: skip
    group.add_argument("--topic", help=f"JointState topic ({topic})")
    group.add_argument("--gear", nargs="+", type=_NOT_ZERO, metavar="N",
                       help="motor turns per joint turn, negative where they turn against each other; says that "
                       "the messages hold the motors' positions, velocities and efforts (the joints')")  # fmt: skip
    group.add_argument("--torque-constant", nargs="+", type=_NOT_ZERO, metavar="K",
                       help="torque per unit of effort, where effort is a current: Nm/A of the motor with --gear, else "
                       "at the joint (1)")  # fmt: skip
