"""The demonstration's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError
from rx90_emulator.cli import demo as command
from rx90_emulator.cli.frame import run


class Noon:
    """A clock that stands still."""

    @staticmethod
    def now() -> Noon:
        """Return noon."""
        return Noon()

    def strftime(self, _layout: str) -> str:
        """Return its name."""
        return "noon"


def test_two_demonstrations_in_a_second_have_folders_of_their_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Folders named by the time do not collide, and each has its folder of logs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "datetime", Noon)
    made = [command._folder(None) for _ in range(3)]
    assert [folder.name for folder in made] == ["noon", "noon-2", "noon-3"]
    assert all((folder / "log").is_dir() for folder in made)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """A folder that exists, or lies in a file, is refused with its name."""
    file = tmp_path / "file"
    file.touch()
    for folder in (tmp_path, file / "inside"):
        with pytest.raises(ConfigError, match=f"--output {folder}"):
            command._folder(folder)


@pytest.mark.parametrize("task", ["nowhere.yaml", "out_of_reach.yaml"])
def test_a_bad_task_leaves_nothing_behind(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], task: str
) -> None:
    """A task that cannot be read or travelled is one line; no folder is made."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out_of_reach.yaml").write_text(
        "line: {provenance: assumed, source: test, start: [0.6, 0.0, 0.2], end: [2.6, 0.0, 0.2], speed: 0.1, "
        "acceleration: 1.0, tool_rpy_degrees: [0.0, 180.0, 0.0]}",
        encoding="utf-8",
    )
    assert run("rx90_demo", ["--task", task]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("rx90_demo: ")
    assert [path.name for path in tmp_path.iterdir()] == ["out_of_reach.yaml"]
