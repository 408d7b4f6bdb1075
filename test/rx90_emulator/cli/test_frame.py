"""The frame of the executables: at once there, one line for what is wrong, and the same exit codes everywhere."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module

import pytest

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import FILES
from rx90_common.process.children import executable
from rx90_emulator.cli.frame import EXECUTABLES
from rx90_emulator.cli.options import CommandParser, split_ros_args


def actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options of a parser and of its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from actions(verb)
        else:
            yield action


@pytest.mark.parametrize("name", EXECUTABLES)
def test_help_needs_neither_compiler_nor_middleware(name: str) -> None:
    """An executable prints its help, exit codes at its end, without numba, SciPy or rclpy, which take seconds."""
    program = (
        f"import sys\nfrom rx90_emulator.cli.frame import {name}\nsys.argv[1:] = ['--help']\n"
        f"code = {name}()\nprint(code, sorted({{'numba', 'scipy', 'rclpy'}} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith(f"usage: {name} ")
    assert "exit status: 0 done" in done.stdout
    assert done.stdout.endswith("gone.\n0 []\n")


@pytest.mark.parametrize("name", [*EXECUTABLES, "rx90_nothing"])
def test_an_unknown_word_is_wrong_usage(name: str) -> None:
    """An option that there is not, and an executable that there is not, end with 2 and say what there is."""
    done = subprocess.run(executable(name, "--nonsense"), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("usage: ")


@pytest.mark.parametrize("name", EXECUTABLES)
def test_files_that_help_names_are_shipped(name: str) -> None:
    """Each file of config/ that the help of an executable or of a verb names is there."""
    parser = CommandParser(prog=name)
    import_module(EXECUTABLES[name]).add_arguments(parser)
    for action in actions(parser):
        for file in re.findall(r"[a-z]+/\w+\.(?:yaml|urdf)", f"{action.help} {action.default}"):
            assert config_path(file).is_file(), f"{action.option_strings or action.dest}: {file}"


LONG = "x" * 5000
CALLS_WITH_LONG_NAMES = (
    ("rx90_run", "--output"),
    ("rx90_run", "--arrays"),
    ("rx90_run", "--task"),
    ("rx90_bag", "info"),
    ("rx90_sweep", "info"),
    ("rx90_demo", "--output"),
    ("friction_ramp", "--output"),
)


@pytest.mark.parametrize("words", CALLS_WITH_LONG_NAMES)
def test_a_name_that_the_system_refuses_is_one_line(words: tuple[str, ...]) -> None:
    """A file name longer than the system takes is refused with 2 and a line, by every command."""
    done = subprocess.run(executable(*words, LONG), capture_output=True, text=True, timeout=60, check=False)
    told = [line for line in done.stderr.splitlines() if "compiling" not in line]
    assert (done.returncode, len(told)) == (2, 1), done.stderr
    assert told[0].startswith(f"{words[0]}: ")
    assert "File name too long" in told[0]


def test_a_folder_is_no_result_of_a_sweep() -> None:
    """An empty name, which is the folder one is in, is refused in a line for the result of a sweep."""
    for words in (("info", ""), ("run", "sweep/reference_1000.yaml", "--output", "")):
        command = executable("rx90_sweep", *words)
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 2, done.stderr
        assert ". is a folder; accepted: a file" in done.stderr


def test_arguments_for_ros_end_at_two_dashes() -> None:
    """What stands between --ros-args and -- is for ROS, all else for the command."""
    words = ["a", "--ros-args", "-r", "x:=y", "--", "b", "--ros-args", "-p", "c:=1"]
    assert split_ros_args(words) == (["a", "b"], ["--ros-args", "-r", "x:=y", "--ros-args", "-p", "c:=1"])


def test_an_option_means_the_same_everywhere() -> None:
    """What names a file in one command does so in all, and no option of a name takes here a value and there none."""
    kinds: dict[str, set[tuple[type, object]]] = {}
    for name, module in EXECUTABLES.items():
        parser = CommandParser(prog=name)
        import_module(module).add_arguments(parser)
        for action in actions(parser):
            for flag in action.option_strings:
                metavar = action.metavar if flag[2:] in {*FILES, "robot", "node", "timeout"} else None
                kinds.setdefault(flag, set()).add((type(action), metavar))
    assert {flag for flag, found in kinds.items() if len(found) > 1} == set()
    assert {kinds[f"--{role}"].pop()[1] for role in FILES} == {"FILE"}
    assert kinds["--robot"].pop()[1] == "ROBOT"
    assert kinds["--node"].pop()[1] == "NAME"
