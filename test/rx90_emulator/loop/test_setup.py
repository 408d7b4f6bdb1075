"""Everything a run needs, read from files of the user's own or from the shipped ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import PAPER, RobotFiles
from rx90_emulator.loop.setup import Setup


def test_the_tool_can_be_the_user_s_own_or_none(shipped_files: RobotFiles, edited_yaml: Callable[..., Path]) -> None:
    """A changed mass of the tool reaches the arm's last body, which has its own without a tool."""
    tool = edited_yaml(shipped_files.tool or Path(), ("inertial", "mass"), 1.25)
    assert Setup.load(RobotFiles(tool=tool)).robot.chain.mass[5] == pytest.approx(1.45)
    assert Setup.load(RobotFiles(tool=None)).robot.chain.mass[5] == pytest.approx(0.2)


@pytest.mark.parametrize("name", ["urdf", "tool", "drives", "friction", "controller"])
def test_a_missing_file_is_refused_by_its_path(name: str, tmp_path: Path) -> None:
    """Each file that does not exist is refused in one line with its path."""
    path = tmp_path / "nowhere.yaml"
    with pytest.raises(ConfigError) as caught:
        Setup.load(RobotFiles(**{name: path}))
    assert str(caught.value).startswith(f"{path}: cannot be read")
    assert "\n" not in str(caught.value)


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


def test_plants_and_controllers_do_not_share_state(shipped: Setup) -> None:
    """Two plants of one setup are two robots, and two controllers two cabinets."""
    first, second = shipped.plant(), shipped.plant()
    first.step(np.full(6, 0.3))
    assert second.tick == 0
    assert not second.joint_states()[1].any()
    one, other = shipped.cs7b(), shipped.cs7b()
    one.step(np.full(6, 0.3), np.zeros(6))
    assert other.tick == 0
    assert not other.state["command"][0].any()
