"""What the files of a robot say of where their numbers come from."""

from __future__ import annotations

from pathlib import Path

from rx90_common.description.robot_files import RobotFiles, provenance_of


def test_each_file_tells_of_its_blocks_else_of_itself(tmp_path: Path) -> None:
    """By block where blocks say it, by file where that says it alone, and that it is not said where nothing does.

    The URDF is left out, and so is a file that the robot has not.
    """
    texts = {
        "drives": "a: {provenance: assumed, x: 1}\nb: {provenance: published, x: 1}\nc: {x: 1}\n",
        "friction": "provenance: identified\nblock: {x: 1}\n",
        "controller": "x: 1\n",
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    files = RobotFiles(tmp_path / "none.urdf", None, *(tmp_path / f"{name}.yaml" for name in texts))
    assert provenance_of(files) == {
        "drives": ["a assumed", "b published"], "friction": ["identified"], "controller": ["not said"],
    }  # fmt: skip
