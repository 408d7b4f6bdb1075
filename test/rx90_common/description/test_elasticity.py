"""The elasticity block of a drives file: what is read, what is refused, and where else its values appear."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import LINK, MOTOR, Elasticity, load_drives
from rx90_common.description.robot_files import RobotFiles

Edit = Callable[..., Path]
STIFFNESS = [1e5, math.inf, 5e4, 1e4, 6e3, 2e3]
BLOCK = {
    "provenance": "assumed",
    "stiffness": STIFFNESS,
    "damping": [20.0, 0.0, 5.0, 1.0, 0.6, 0.2],
    "backlash": [0.0, 0.0, 0.0, 1e-4, 2e-4, 3e-4],
    "friction": LINK,
}


def test_a_file_gives_elasticity_and_play(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """Stiffness, damping, play and side are read; a block with a stiffness alone has neither damping nor play."""
    found = load_drives(edited_yaml(shipped_files.drives, ("elasticity",), BLOCK)).elasticity
    for name in ("stiffness", "damping", "backlash"):
        assert getattr(found, name).tolist() == BLOCK[name]
    assert found.friction_side == LINK
    assert found.elastic.tolist() == [True, False, True, True, True, True]
    short = load_drives(edited_yaml(shipped_files.drives, ("elasticity",), {"stiffness": STIFFNESS})).elasticity
    assert not short.damping.any()
    assert not short.backlash.any()
    assert short.friction_side == MOTOR


def test_shipped_robots_are_rigid() -> None:
    """Without the block every drive is rigid, as in all shipped robots."""
    for robot in ("rx90b", "tx40"):
        assert not load_drives(RobotFiles.named(robot).drives).elasticity.elastic.any()


@pytest.mark.parametrize("key", ["damping", "backlash"])
def test_a_rigid_drive_has_neither_damping_nor_play(shipped_files: RobotFiles, edited_yaml: Edit, key: str) -> None:
    """Damping or play beside an infinite stiffness is refused, not ignored: from a file and from Python."""
    values = [0.0, 1e-4, 0.0, 0.0, 0.0, 0.0]
    path = edited_yaml(shipped_files.drives, ("elasticity",), {**BLOCK, key: values})
    assert f"{path}: elasticity: {key}[1] is 0.0001, stiffness[1] infinite; accepted: 0" in refusal_by(
        load_drives, path
    )
    with pytest.raises(ConfigError, match=rf"{key}\[1\] is 0.0001, stiffness\[1\] infinite; accepted: 0"):
        Elasticity(np.array(STIFFNESS), **{key: np.array(values)})
