"""The set-up that every make target goes through: when it installs, and what it refuses; the system's packages."""

from pathlib import Path

import pytest

from tools.environment import Environment, UnsuitableError


class Recorded(Environment):
    """An environment whose commands are written down; each leaves what the real one would."""

    def __init__(self, root: Path) -> None:
        super().__init__(root / ".venv", root)
        self.commands: list[str] = []

    def _run(self, command: list[str]) -> None:
        self.commands.append(f"{command[2]} {command[-1]}")
        if command[2] == "venv":
            self.python.parent.mkdir(parents=True, exist_ok=True)
            self.python.touch()

    def updated(self, *extras: str) -> list[str]:
        self.commands.clear()
        self.update(set(extras))
        return [command.replace(str(self.root), "ROOT") for command in self.commands]


@pytest.fixture
def environment(tmp_path: Path) -> Recorded:
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
