"""The frame of the executables: at once there, one line for what is wrong, and the same exit codes everywhere."""

from __future__ import annotations

import argparse
import itertools
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from rx90_common.base.errors import REFUSED
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import FILES
from rx90_common.process.children import executable
from rx90_emulator.cli.frame import EXECUTABLES, run
from rx90_emulator.cli.options import CommandParser, command_of, split_ros_args


def actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options of a parser and of its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from actions(verb)
        else:
            yield action


HELP = """
import os
import sys
from rx90_emulator.cli import frame
sys.argv[1:] = ["--help"]
for name in frame.EXECUTABLES:
    code = getattr(frame, name)()
    slow = {"numba", "scipy", "rclpy"} & set(sys.modules)
    print("end", code, sorted(slow), os.environ["OPENBLAS_NUM_THREADS"], flush=True)
"""


@pytest.mark.parametrize("threads", [None, "3"])
def test_help_needs_neither_compiler_nor_middleware(threads: str | None) -> None:
    """Executables print help and exit codes without numba, SciPy or rclpy, and have told OpenBLAS its threads."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads or ""}
    if threads is None:
        del environment["OPENBLAS_NUM_THREADS"]
    command = [sys.executable, "-c", HELP]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    pages = done.stdout.split(f"end 0 [] {threads or 1}\n")
    assert pages.pop() == ""
    for name, text in zip(EXECUTABLES, pages, strict=True):
        assert text.startswith(f"usage: {name} ")
        assert "exit status: 0 done" in text
        assert text.endswith("gone.\n")


@pytest.mark.parametrize("name", ["rx90_nothing", "rx90_run"])
def test_wrong_usage_is_the_exit_code(name: str) -> None:
    """As a process, an option that there is not and an executable that there is not end with 2 as well."""
    done = subprocess.run(executable(name, "--nonsense"), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: ")


@pytest.fixture(scope="module")
def options() -> dict[str, list[argparse.Action]]:
    """Return the arguments of every executable and its verbs."""
    found = {}
    for name, place in EXECUTABLES.items():
        parser, _ = command_of(name, place)
        found[name] = list(actions(parser))
    return found


def test_options_say_what_they_take(options: dict[str, list[argparse.Action]]) -> None:
    """Files that a help names are there, and an option takes the same in all commands, but for `--excitation`."""
    kinds: dict[str, set[tuple[type, object]]] = {}
    for action in itertools.chain(*options.values()):
        for file in re.findall(r"[a-z]+/\w+\.(?:yaml|urdf)", f"{action.help} {action.default}"):
            assert config_path(file).is_file(), f"{action.option_strings or action.dest}: {file}"
        assert action.type not in (int, float), action.option_strings  # whose refusal does not say what is accepted
        for flag in action.option_strings:
            metavar = action.metavar if flag[2:] in {*FILES, "robot", "node", "timeout"} else None
            kinds.setdefault(flag, set()).add((type(action), metavar))
    assert {flag for flag, found in kinds.items() if len(found) > 1} == {"--excitation"}
    assert {kinds[f"--{role}"].pop()[1] for role in FILES} == {"FILE"}
    assert (kinds["--robot"].pop()[1], kinds["--node"].pop()[1]) == ("ROBOT", "NAME")


WRITTEN = {
    "--output": {
        "friction_ramp": [],
        "rx90_bag": ["record"],
        "rx90_controller_check": [],
        "rx90_correct": ["learn", "nowhere"],
        "rx90_demo": [],
        "rx90_experiment": ["run", "--engine", "--robot", "nowhere"],
        "rx90_export": ["urdf", "--robot", "nowhere"],
        "rx90_identify": ["nowhere"],
        "rx90_line": ["--task", "nowhere"],
        "rx90_own_controller": ["--engine", "--robot", "nowhere"],
        "rx90_path": ["nowhere"],
        "rx90_program": ["nowhere"],
        "rx90_run": ["--task", "nowhere"],
        "rx90_sweep": ["run", "nowhere"],
    },
    "--report": {
        "rx90_identify": ["nowhere"],
        "rx90_compare_measured": ["nowhere"],
        "rx90_program": ["nowhere"],
        "rx90_sweep": ["run", "nowhere", "--output", "x"],
    },
    "--arrays": {"rx90_run": ["--task", "nowhere"]},
    "bag": {"rx90_bag": ["import", "--signals", "nowhere", "nowhere"]},
}
"""By what is written, the commands that write it, with inputs that there are not."""


def test_what_is_written_is_looked_at_before_anything_else(
    options: dict[str, list[argparse.Action]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Each command refuses an output that cannot be written before it looks at its inputs, and no command is left out.

    Nobody writes below /proc, not even root.
    """
    for option, commands in WRITTEN.items():
        for name, words in commands.items():
            assert run(name, [*words, *([option] if option.startswith("-") else []), "/proc/x"]) == REFUSED
            error = capsys.readouterr().err.splitlines()
            assert error[-1].startswith(f"{name}: /proc/x: cannot be written ("), error
    writers = {
        (flag, name)
        for name, found in options.items()
        for action in found
        for flag in {"--output", "--report", "--arrays"}.intersection(action.option_strings)
    }
    assert writers == {(option, name) for option, names in WRITTEN.items() for name in names if option != "bag"}


def test_arguments_for_ros_end_at_two_dashes() -> None:
    """What stands between --ros-args and -- is for ROS, all else for the command."""
    words = ["a", "--ros-args", "-r", "x:=y", "--", "b", "--ros-args", "-p", "c:=1"]
    assert split_ros_args(words) == (["a", "b"], ["--ros-args", "-r", "x:=y", "--ros-args", "-p", "c:=1"])


def test_negative_numbers_with_exponents_are_no_options() -> None:
    """A verb's option takes -1e-3 and -inf, as it takes -0.001, for its type to judge; what is no number is none."""
    parser = CommandParser()
    verb = parser.add_subparsers().add_parser("plan")
    verb.add_argument("--wall", nargs=4, type=float)
    given = verb.parse_args(["--wall", "-1e-3", "-.5E+1", "-2.e3", "-inf"]).wall
    assert given == [-0.001, -5.0, -2000.0, -math.inf]
    for word in ("-1e", "-e3", "-x1e3"):
        with pytest.raises(SystemExit):
            verb.parse_args(["--wall", "1", "1", "1", word])
