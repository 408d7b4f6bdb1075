"""Where the page writes: names that stay beneath its folder, and files that are there."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError
from rx90_emulator.view.page import ExistingFileError, OutputFolder


@pytest.fixture
def output(tmp_path: Path) -> OutputFolder:
    """Return a folder with files, folders and links in it, and a file beside it."""
    (tmp_path / "beside.yaml").write_text("beside")
    folder = tmp_path / "page"
    (folder / "sub").mkdir(parents=True)
    (folder / "there.yaml").write_text("there")
    (folder / "out").symlink_to(tmp_path)
    (folder / "link.yaml").symlink_to(tmp_path / "beside.yaml")
    (folder / "nowhere.yaml").symlink_to(tmp_path / "nowhere.yaml")
    return OutputFolder(folder)


@pytest.mark.parametrize("name", ["new.yaml", "sub/new.yaml", "two words.yaml", "~", "sub//new.yaml"])
def test_new_names_beneath_the_folder_are_taken(output: OutputFolder, name: str) -> None:
    """A name that is free gives a path beneath the folder, in which nothing is made."""
    path = output.path_for(name)
    assert path.parent in {output.folder, output.folder / "sub"}
    assert not path.exists()


@pytest.mark.parametrize("replace", [False, True])
@pytest.mark.parametrize(
    "name",
    ["", " ", "..", ".", "../beside.yaml", "sub/../../beside.yaml", "sub/../there.yaml", "/etc/passwd", "/", ".bashrc",
     "sub/.git", "out/beside.yaml", "out/new.yaml", "link.yaml", "nowhere.yaml", "sub", "missing/new.yaml",
     "there.yaml/new.yaml", "a\0b", "a\nb", "x" * 300, "x" * 300 + "/y"],
)  # fmt: skip
def test_what_leads_elsewhere_is_refused_also_when_confirmed(output: OutputFolder, name: str, replace: bool) -> None:
    """No `..`, absolute path, hidden name, link or folder is taken; the refusal is one line that says what is."""
    with pytest.raises(ConfigError, match="; accepted: a new name beneath") as refusal:
        output.path_for(name, replace=replace)
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_there_is_taken_only_when_confirmed(output: OutputFolder) -> None:
    """Without a confirmation the refusal names the file, and is told from the others."""
    with pytest.raises(ExistingFileError, match=r"there\.yaml exists; accepted: a new name beneath"):
        output.path_for("there.yaml")
    assert output.path_for("there.yaml", replace=True).read_text() == "there"


def test_a_folder_is_made_or_refused(tmp_path: Path) -> None:
    """A folder that is missing is made; a file in its place is one line."""
    assert OutputFolder(tmp_path / "a" / "b").folder.is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"file: cannot be written \(.*\); accepted: a folder that exists or can"):
        OutputFolder(tmp_path / "file")
