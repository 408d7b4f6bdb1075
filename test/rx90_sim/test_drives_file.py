"""The drives file: every key refuses what it cannot be, in one line that names it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import DriveParameters, load_drives
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.loop.setup import Setup

Edit = Callable[..., Path]
SIX = [
    ("transmission", "gear"),
    ("transmission", "rotor_inertia"),
    ("motor", "torque_constant"),
    ("motor", "peak_current"),
    ("brake", "torque"),
    ("brake", "stiffness"),
    ("brake", "damping"),
    ("spring", "torque"),
    ("end_stops", "stiffness"),
    ("end_stops", "damping"),
]
ONE = [("encoder", "counts_per_revolution"), ("encoder", "velocity_bandwidth")]
MAY_BE_ZERO = {
    ("transmission", "rotor_inertia"),
    ("brake", "damping"),
    ("spring", "torque"),
    ("end_stops", "stiffness"),
    ("end_stops", "damping"),
}
WRONG = [-1.5, math.nan, math.inf, "strong", None, True]


def refusal(path: Path) -> str:
    """Return the one line with which the file is refused."""
    return refusal_by(load_drives, path)


def test_these_are_all_keys(shipped_files: RobotFiles) -> None:
    """The lists above name every key of the shipped file, so that none goes untested."""
    data = yaml.safe_load(shipped_files.drives.read_text())
    keys = [(block, key) for block in data for key in data[block] if key not in {"source", "provenance"}]
    assert sorted(keys) == sorted(SIX + ONE)


@pytest.mark.parametrize("place", SIX, ids=".".join)
def test_a_bad_list_is_refused(shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]) -> None:
    """One bad number of six, another length, a single number or a text is refused by file, key, index and value.

    Zero is accepted for what may be absent, and a motor may turn against its joint.
    """
    file, name = shipped_files.drives, ".".join(place)
    for value in [*WRONG, 0.0]:
        path = edited_yaml(file, (*place, 4), value)
        if (value == 0.0 and place in MAY_BE_ZERO) or (value == -1.5 and place == ("transmission", "gear")):
            load_drives(path)
        else:
            assert f"{name}[4] is {value!r};" in refusal(path)
    for other in ([1.0] * 5, [1.0] * 7, 3.0, "1 2 3 4 5 6", None, {"joint_1": 1.0}):
        assert f"{name} is {other!r}; accepted: 6 numbers" in refusal(edited_yaml(file, place, other))
    assert f"{name} is missing" in refusal(edited_yaml(file, place, None, remove=True))


@pytest.mark.parametrize("place", ONE, ids=".".join)
def test_a_bad_single_value_is_refused(shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]) -> None:
    """A single value out of its range, or that is no whole number where one is needed, is refused by file and key."""
    file, name = shipped_files.drives, ".".join(place)
    for value in [*WRONG, [1.0], 0.0]:
        assert f"{name} is {value!r};" in refusal(edited_yaml(file, place, value))
    assert f"{name} is missing" in refusal(edited_yaml(file, place, None, remove=True))
    for counts in (15, 65536.0, 2**31) if place == ONE[0] else ():
        assert f"{name} is {counts!r}; accepted: an integer in" in refusal(edited_yaml(file, place, counts))


@pytest.mark.parametrize("block", ["transmission", "motor", "encoder", "brake", "spring", "end_stops"])
def test_a_block_is_checked(shipped_files: RobotFiles, edited_yaml: Edit, block: str) -> None:
    """A missing block, a block that is no mapping and an unknown key in it are refused by name."""
    assert f"{block} is missing" in refusal(edited_yaml(shipped_files.drives, (block,), None, remove=True))
    assert f"{block} is 3; accepted: a mapping" in refusal(edited_yaml(shipped_files.drives, (block,), 3))
    assert f"{block}.colour is not a known key" in refusal(edited_yaml(shipped_files.drives, (block, "colour"), 1))
    assert f"{block}.provenance is 'guessed'" in refusal(
        edited_yaml(shipped_files.drives, (block, "provenance"), "guessed")
    )


def test_an_unknown_block_is_refused(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """A block that nothing reads is refused."""
    assert "motors is not a known key" in refusal(edited_yaml(shipped_files.drives, ("motors",), {}))


@pytest.mark.parametrize(
    "name", [f.name for f in dataclasses.fields(DriveParameters) if f.default_factory is dataclasses.MISSING]
)
def test_drives_built_in_python_are_checked(shipped: Setup, name: str) -> None:
    """DriveParameters refuses negative, undefined and wrongly sized values by name; of a gear, zero alone."""
    value = getattr(shipped.drives, name)
    for bad in (0.0 if name == "gear" else -1.0, math.nan, math.inf):
        with pytest.raises(ConfigError, match=rf"drives: {name}(\[0\])? is .*; accepted"):
            dataclasses.replace(shipped.drives, **{name: value * 0 + bad})
    if np.ndim(value):
        with pytest.raises(ConfigError, match=rf"drives: {name} is .*; accepted: 6 "):
            dataclasses.replace(shipped.drives, **{name: value[:5]})
