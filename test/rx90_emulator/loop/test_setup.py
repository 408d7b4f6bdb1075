"""Everything a run needs, read from files of the user's own or from the shipped ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.description.robot_files import RobotFiles
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
