"""Names that somebody else takes while a bag or a file is written, and names that are too long."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_making import series

from rx90_common.bags.reading import read_bag
from rx90_common.bags.writing import BagWriter, named_at_the_end, write_joint_states
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run


def test_a_bag_that_came_first_stays(tmp_path: Path) -> None:
    """Of two writers of one bag the second is refused by the name, and leaves nothing."""
    bag = tmp_path / "run"

    def second() -> None:
        with named_at_the_end(bag) as folder:
            (folder / "run").mkdir()
            bag.mkdir()
            (bag / "metadata.yaml").write_text("of the first")

    with pytest.raises(BagError, match="run exists already, not overwriting"):
        second()
    assert list(tmp_path.rglob("*")) == [bag, bag / "metadata.yaml"]


@pytest.mark.parametrize("single", [True, False])
def test_an_export_that_came_first_stays(tmp_path: Path, single: bool) -> None:
    """Of two exports to one file or folder the second is refused by the name, and leaves nothing."""
    output = tmp_path / "export.csv"

    def second() -> None:
        with named_at_the_end(output) as folder:
            (folder / output.name).write_text("of the second") if single else (folder / output.name).mkdir()
            if single:
                output.write_text("of the first")
            else:
                output.mkdir()
                (output / "a.csv").write_text("of the first")

    with pytest.raises(BagError, match=r"export\.csv exists already, not overwriting"):
        second()
    assert all(file.is_dir() or file.read_text() == "of the first" for file in tmp_path.rglob("*"))
    assert len(list(tmp_path.iterdir())) == 1


LONGEST = 243
"""Bytes: a file system's 255 without the 12 of .db3-journal."""


def test_the_longest_name_can_be_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bag with the longest name, also one of characters of four bytes, is written and read; one byte more is not."""
    monkeypatch.chdir(tmp_path)
    for character in "x", "\N{ROBOT FACE}":
        name = character * (LONGEST // len(character.encode()))
        write_joint_states(name, [series()])
        assert run("rx90_bag", ["info", name]) == 0
        assert read_bag(name)["joint_states"].stamp_ns.size == 20
    capsys.readouterr()
    for write in BagWriter, lambda path: write_joint_states(path, [series()]):
        with pytest.raises(BagError, match=r"has 244 bytes; accepted: up to 243"):
            write("z" * (LONGEST + 1))
    assert len(list(tmp_path.iterdir())) == 2


def test_a_path_beyond_that_of_a_database_is_refused(tmp_path: Path) -> None:
    """SQLite takes paths of 512 bytes with that of the journal; one byte more is refused, and nothing stays."""
    deep = tmp_path.joinpath(*["d" * 100] * 2)
    name = "x" * ((512 - len(str(deep / "a" / "b.db3-journal")) + 2) // 2)
    for extra, accepted in ("", True), ("x", False):
        path = deep / f"{name}{extra}"
        size = len(str(path / f"{path.name}.db3-journal"))
        if accepted:
            with BagWriter(path, "sqlite3") as bag:
                bag.add_topic("a", "std_msgs/msg/String")
            assert size in {511, 512}
            read_bag(path)
        else:
            with pytest.raises(BagError, match=rf"a path of {size - 8} bytes; accepted by SQLite: up to 504"):
                BagWriter(path, "sqlite3")
            assert not path.exists()
            write_joint_states(path, [series()])


COMMANDS = {
    "record": ["rx90_bag", "record", "--output", "{}"],
    "import": ["rx90_bag", "import", "none.csv", "{}"],
    "export": ["rx90_bag", "export", "none", "--output", "{}"],
    "run": ["rx90_run", "--start", "0.6", "-0.2", "0.2", "--end", "0.6", "0.2", "0.2", "--output", "{}"],
    "experiment": ["rx90_experiment", "run", "--engine", "--output", "{}"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_refuse_a_name_that_is_too_long_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever makes a bag or a folder says first that a name of 250 bytes is too long, and makes nothing."""
    monkeypatch.chdir(tmp_path)
    name, *arguments = (word.replace("{}", "x" * 250) for word in COMMANDS[command])
    assert run(name, arguments) == 2
    out, err = capsys.readouterr()
    assert "its name has 250 bytes; accepted: up to 243" in err
    assert (out, err.count("\n"), list(tmp_path.iterdir())) == ("", 1, [])
