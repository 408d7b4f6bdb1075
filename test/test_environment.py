"""The set-up that every make target goes through: when it installs, and what it refuses."""

from __future__ import annotations

import importlib.util
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tools.environment import ROOT, Environment, UnsuitableError, check_machine


class Recorded(Environment):
    """An environment whose commands are written down; each leaves what the real one would."""

    def __init__(self, root: Path) -> None:
        super().__init__(root / ".venv", root)
        self.commands: list[str] = []
        self.fails = False

    def _run(self, command: list[str]) -> None:
        if self.fails:
            raise UnsuitableError("no network")
        self.commands.append(f"{command[2]} {command[-1]}")
        if command[2] == "venv":
            self.python.parent.mkdir(parents=True, exist_ok=True)
            self.python.touch()

    def updated(self, *extras: str) -> list[str]:
        """Update and return the commands this took."""
        self.commands.clear()
        self.update(set(extras))
        return [command.replace(str(self.root), "ROOT") for command in self.commands]


@pytest.fixture
def environment(tmp_path: Path) -> Recorded:
    """Return an environment for a source tree of build files alone."""
    for name in ("setup.py", "setup.cfg", "pyproject.toml"):
        (tmp_path / name).write_text("")
    return Recorded(tmp_path)


def test_a_second_run_installs_nothing(environment: Recorded) -> None:
    """Once installed, the same and lesser purposes take no command at all; a wider one is added to what is there."""
    assert environment.updated("ros") == ["venv ROOT/.venv", "pip pip>=25,<27", "pip ROOT[ros]"]
    assert environment.updated("dev") == ["pip ROOT[dev,ros]"]
    assert environment.updated("ros", "dev") == []
    assert environment.updated("ros") == []


def test_the_environment_of_another_tree_is_left_alone(environment: Recorded, tmp_path: Path) -> None:
    """A link to one, as between two work trees, is refused before anything is cleared or installed."""
    environment.folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UnsuitableError, match=r"/\.venv is a link to .*/elsewhere; accepted: a folder of this tree"):
        environment.updated("ros")
    assert environment.commands == []


@pytest.mark.parametrize("name", ["setup.py", "setup.cfg", "pyproject.toml", "new_room/__init__.py"])
def test_a_changed_build_file_is_installed_again(name: str, environment: Recorded) -> None:
    """A change of a build file or a new room re-installs, once, without making the environment anew."""
    environment.updated("ros")
    (environment.root / name).parent.mkdir(exist_ok=True)
    (environment.root / name).write_text("# changed")
    assert environment.updated("ros") == ["pip ROOT[ros]"]
    assert environment.updated("ros") == []


def test_a_failed_installation_is_done_again(environment: Recorded) -> None:
    """An installation that failed half-way is completed by the next run in the same environment."""
    environment.updated("ros")
    (environment.root / "setup.py").write_text("# changed")
    environment.fails = True
    with pytest.raises(UnsuitableError):
        environment.updated("ros")
    (environment.root / "setup.py").write_text("")
    environment.fails = False
    assert environment.updated("ros") == ["pip ROOT[ros]"]


def test_another_interpreter_or_place_makes_it_anew(environment: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another Python version makes the environment anew, and so does a lost interpreter."""
    environment.updated("ros")
    environment.python.unlink()
    assert environment.updated("ros") == ["venv ROOT/.venv", "pip pip>=25,<27", "pip ROOT[ros]"]
    monkeypatch.setattr(sys, "version_info", (3, 99, 0))
    assert environment.updated("ros") == ["venv ROOT/.venv", "pip pip>=25,<27", "pip ROOT[ros]"]


@pytest.mark.parametrize(
    ("module", "name", "answer", "said"),
    [
        (platform, "python_implementation", "PyPy", "PyPy; accepted: CPython"),
        (platform, "machine", "aarch64", "Linux on aarch64; accepted: 64-bit Linux on x86_64"),
        (platform, "libc_ver", ("glibc", "2.27"), "glibc 2.27; accepted: glibc >= 2.28"),
        (platform, "libc_ver", ("", ""), "not glibc ; accepted: glibc >= 2.28"),
        (importlib.util, "find_spec", None, "has no venv module"),
    ],
)
def test_an_unsuitable_machine_is_refused(
    module: object, name: str, answer: object, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine without wheels is refused in one line that says what was found and what is accepted."""
    monkeypatch.setattr(module, name, lambda *_: answer)
    with pytest.raises(UnsuitableError, match=said) as caught:
        check_machine()
    assert "\n" not in str(caught.value)


def test_make_refuses_an_unsuitable_python_in_one_line(tmp_path: Path) -> None:
    """`make demo` with an interpreter that is too old names it and what is accepted, and installs nothing."""
    old = tmp_path / "python3.9"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.9.18\nexit 1\n')
    old.chmod(0o755)
    done = subprocess.run(["make", "demo", f"PYTHON={old}"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    lines = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert lines == [f"PYTHON={old} is Python 3.9.18; accepted: CPython 3.10 to 3.13, for example PYTHON=python3.12"]
