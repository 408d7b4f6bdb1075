"""The frame of the executables: at once there, one line for what is wrong, and the same exit codes everywhere."""

from __future__ import annotations

import subprocess
import sys

import pytest

from rx90_common.process.children import executable
from rx90_emulator.cli.frame import EXECUTABLES
from rx90_emulator.cli.options import split_ros_args


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


def test_arguments_for_ros_end_at_two_dashes() -> None:
    """What stands between --ros-args and -- is for ROS, all else for the command."""
    words = ["a", "--ros-args", "-r", "x:=y", "--", "b", "--ros-args", "-p", "c:=1"]
    assert split_ros_args(words) == (["a", "b"], ["--ros-args", "-r", "x:=y", "--ros-args", "-p", "c:=1"])
