"""The files of a robot, by their folder or one by one, and where their values come from."""

from pathlib import Path

import pytest
import yaml

from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import (
    DEFAULT_ROBOT,
    FILES,
    NO_TOOL,
    PAPER,
    RobotFiles,
    provenance_of,
    shipped_robots,
)


def folder_with(folder: Path, *roles: str) -> Path:
    folder.mkdir()
    for role in roles:
        (folder / FILES[role]).write_text("", encoding="utf-8")
    return folder


@pytest.mark.parametrize("robot", sorted(path.name for path in config_path("robots").iterdir()))
def test_a_shipped_name_names_every_file_of_its_folder(robot: str) -> None:
    """Each folder below config/robots is a shipped robot with the files of its folder; no tool.yaml, no tool."""
    assert robot in shipped_robots()
    files, folder = RobotFiles.named(robot), config_path("robots") / robot
    there = {path.name for path in folder.iterdir()}
    assert there <= {*FILES.values(), "moveit"} | {name.removeprefix(f"{robot}/") for name in shipped_robots()}
    for role, name in FILES.items():
        assert getattr(files, role) == (folder / name if name in there else None)
        assert files.text(role) == (f"robots/{robot}/{name}" if name in there else NO_TOOL)


def test_the_rx90b_is_the_default() -> None:
    """Without a name the files are those of the RX90B, with its tool, task and poses."""
    assert RobotFiles() == RobotFiles.named() == RobotFiles.named(DEFAULT_ROBOT)
    assert all(getattr(RobotFiles(), role).parent.name == "rx90b" for role in FILES)


def test_a_folder_of_the_user_s_own_is_a_robot(tmp_path: Path) -> None:
    """A path names a folder; no tool file, no tool; a missing task is refused where asked for; a single file wins."""
    own = folder_with(tmp_path / "arm", "urdf", "drives", "friction", "controller")
    files = RobotFiles.named(str(own))
    assert (files.tool, files.task, files.poses) == (None, None, None)
    assert (files.urdf, files.text("drives")) == (own / "robot.urdf", str(own / "drives.yaml"))
    with pytest.raises(ConfigError, match=r"arm: no task.yaml; accepted: a task file, in the folder or named"):
        files.required("task")
    other = RobotFiles.named(str(own), tool="robots/rx90b/tool.yaml", drives=str(own / "friction.yaml"))
    assert (other.tool, other.drives) == (config_path("robots/rx90b/tool.yaml"), own / "friction.yaml")
    assert RobotFiles.named("rx90b", tool=NO_TOOL).tool is None


def test_a_shipped_name_is_not_hidden_by_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of a shipped robot's name in the working folder is named by its path, ./rx90b."""
    folder_with(tmp_path / "rx90b", "urdf")
    monkeypatch.chdir(tmp_path)
    assert RobotFiles.named("rx90b") == RobotFiles()
    assert RobotFiles.named("./rx90b").urdf == Path("rx90b/robot.urdf")


def test_a_variant_has_what_it_lacks_from_the_robot_that_it_lies_in(tmp_path: Path) -> None:
    """A folder without a URDF in a robot folder, shipped or one's own, replaces the files that it has, no others."""
    own, base = RobotFiles.named(PAPER), RobotFiles()
    assert {role for role in FILES if getattr(own, role) != getattr(base, role)} == {"friction", "controller"}
    assert own.text("friction") == "robots/rx90b/paper/friction.yaml"
    robot = folder_with(tmp_path / "arm", "urdf", "tool", "drives", "friction", "controller")
    worn = folder_with(robot / "worn", "friction")
    files = RobotFiles.named(str(worn))
    assert (files.friction, files.tool, files.drives) == (
        worn / FILES["friction"],
        robot / "tool.yaml",
        robot / "drives.yaml",
    )
    whole = folder_with(robot / "whole", "urdf", "friction")
    assert RobotFiles.named(str(whole)).tool is None


def test_what_is_no_robot_is_refused(tmp_path: Path) -> None:
    """A folder without a robot's files, and what is neither a shipped name nor a folder, with what makes one."""
    with pytest.raises(ConfigError, match=rf"^robot '{tmp_path}': none of a robot's files; accepted: a folder with r"):
        RobotFiles.named(str(tmp_path))
    shipped = f"no such folder; accepted: {', '.join(shipped_robots())}, or a robot folder's path"
    for name in ("tx50", "", "x" * 5000, "~nobody_of_this_name/x", "config/robots/rx90b/robot.urdf"):
        with pytest.raises(ConfigError, match=rf"^.*{shipped}.*$"):
            RobotFiles.named(name)


@pytest.mark.parametrize("name", ["friction", "controller"])
def test_the_paper_s_files_do_not_drift_from_the_shipped_ones(name: str) -> None:
    """But for the choices that docs/explanation/models.md lists they hold the shipped keys and values, no others."""
    shipped, paper = (
        yaml.safe_load(config_path(f"robots/{folder}/{name}.yaml").read_text(encoding="utf-8"))
        for folder in ("rx90b", PAPER)
    )
    if name == "friction":
        for element in shipped["elements"].values():
            del element["omega_d"]
        paper["source"] = shipped["source"]
    else:
        files = RobotFiles.named(PAPER)
        assert paper.pop("model") == {role: files.text(role) for role in ("urdf", "tool", "drives", "friction")}
        shipped["feed_forward"] |= {"velocity": False, "coulomb_velocity": 1e-12}
        shipped["supervision"] |= {"following_error": [1.0] * 6, "source": paper["supervision"]["source"]}
    assert paper == shipped


def test_each_file_tells_of_its_blocks_else_of_itself(tmp_path: Path) -> None:
    """By block where blocks say it, by file where that says it alone, and that it is not said where nothing does."""
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
