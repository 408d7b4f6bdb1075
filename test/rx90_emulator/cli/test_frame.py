"""The frame of the executables: at once there, one line for what is wrong, and the same exit codes everywhere."""

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
from rx90_emulator.cli.frame import COMMANDS, VERBS, run
from rx90_emulator.cli.options import CommandParser, command_of, split_ros_args


def actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
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
for words in (["rx90"], *(name.split() for name in frame.COMMANDS)):
    code = frame.execute(words[0], [*words[1:], "--help"])
    slow = {"numba", "numpy", "scipy", "rclpy", "pydantic"} & set(sys.modules)
    print("end", code, sorted(slow), os.environ["OPENBLAS_NUM_THREADS"], flush=True)
"""


@pytest.mark.parametrize("threads", [None, "3"])
def test_help_needs_neither_compiler_nor_middleware(threads: str | None) -> None:
    """Commands print help and exit codes without NumPy, Pydantic or rclpy, and have told OpenBLAS its threads."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads or ""}
    if threads is None:
        del environment["OPENBLAS_NUM_THREADS"]
    command = [sys.executable, "-c", HELP]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    first, *pages, end = done.stdout.split(f"end 0 [] {threads or 1}\n")
    assert end == ""
    named = re.findall(r"^  ([a-z, ]+?)  ", first, re.MULTILINE)
    assert sorted(", ".join(named).split(", ")) == sorted(set(VERBS) - {"completion"})
    for name, text in zip(COMMANDS, pages, strict=True):
        assert text.startswith(f"usage: {name} ")
        assert "exit status: 0 done" in text
        assert text.endswith("gone.\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("rx90 nothing", "rx90: 'nothing' is no verb; accepted: experiment, identify, rig, "),
        ("rx90 run --nonsense", "rx90 run: unrecognized arguments: --nonsense; rx90 run --help says what is accepted"),
        ("rx90 bag --nonsense", "rx90 bag: the following arguments are required: VERB; rx90 bag --help says "),
        ("rx90_sim --nonsense", "rx90_sim: unrecognized arguments: --nonsense; rx90_sim --help says what is accepted"),
    ],
)
def test_wrong_usage_is_a_line_and_the_exit_code(words: str, said: str) -> None:
    """As a process, an option and a verb that there are not end with 2 and one line."""
    done = subprocess.run(executable(words), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith(said)


@pytest.fixture(scope="module")
def options() -> dict[str, list[argparse.Action]]:
    found = {}
    for name in COMMANDS:
        parser, _ = command_of(name)
        found[name] = list(actions(parser))
    return found


def test_options_say_what_they_take(options: dict[str, list[argparse.Action]]) -> None:
    """Files that a help names are there, and an option takes the same in all commands."""
    kinds: dict[str, set[tuple[type, object]]] = {}
    for action in itertools.chain(*options.values()):
        for file in re.findall(r"[a-z]+/\w+\.(?:yaml|urdf)", f"{action.help} {action.default}"):
            assert config_path(file).is_file(), f"{action.option_strings or action.dest}: {file}"
        assert action.type not in (int, float), action.option_strings  # whose refusal does not say what is accepted
        for flag in action.option_strings:
            metavar = action.metavar if flag[2:] in {*FILES, "robot", "node", "timeout"} else None
            kinds.setdefault(flag, set()).add((type(action), metavar))
    assert {flag for flag, found in kinds.items() if len(found) > 1} == set()
    assert {kinds[f"--{role}"].pop()[1] for role in FILES} == {"FILE"}
    assert (kinds["--robot"].pop()[1], kinds["--node"].pop()[1]) == ("ROBOT", "NAME")


WRITTEN = {
    "--output": [
        "rx90 bag record",
        "rx90 check",
        "rx90 correct engine nowhere",
        "rx90 demo",
        "rx90 experiment sliding engine --robot nowhere",
        "rx90 export urdf --robot nowhere",
        "rx90 identify sliding nowhere",
        "rx90 line nowhere",
        "rx90 path nowhere",
        "rx90 program engine nowhere",
        "rx90 replay nowhere",
        "rx90 rig ramp",
        "rx90 run nowhere",
        "rx90 sweep run nowhere",
    ],
    "--report": ["rx90 identify compare nowhere", "rx90 program engine nowhere"],
    "": ["rx90 bag import --signals nowhere nowhere"],
}
"""By what is written, the commands that write it, with inputs that there are not."""


def test_what_is_written_is_looked_at_before_anything_else(
    options: dict[str, list[argparse.Action]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Each command refuses an output that cannot be written (below /proc) before its inputs; no command is left out."""
    listed = set()
    for option, commands in WRITTEN.items():
        for words in commands:
            verb = " ".join(words.split()[:2])
            listed.add((option, verb))
            assert run(words, [option, "/proc/x"] if option else ["/proc/x"]) == REFUSED
            error = capsys.readouterr().err.splitlines()
            assert error[-1].startswith(f"{verb}: /proc/x: cannot be written ("), error
    writers = {
        (flag, name)
        for name, found in options.items()
        for action in found
        for flag in {"--output", "--report"}.intersection(action.option_strings)
    }
    assert writers == {(option, verb) for option, verb in listed if option}


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
