"""The drives file: every key refuses what it cannot be, in one line that names it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
@pytest.mark.parametrize("value", WRONG)
def test_a_bad_value_in_a_list_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """One bad number of six is refused by file, key, index and value."""
    path = edited_yaml(shipped_files.drives, (*place, 4), value)
    if place == ("transmission", "gear") and value == -1.5:  # a motor that turns against its joint
        assert load_drives(path).gear[4] == -1.5
    else:
        assert f"{'.'.join(place)}[4] is {value!r};" in refusal(path)


@pytest.mark.parametrize("place", SIX, ids=".".join)
def test_zero_is_refused_where_it_means_nothing(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]
) -> None:
    """Zero is accepted for what may be absent and refused for what is divided by."""
    path = edited_yaml(shipped_files.drives, (*place, 0), 0.0)
    if place in MAY_BE_ZERO:
        load_drives(path)
    else:
        assert f"{'.'.join(place)}[0] is 0.0;" in refusal(path)


@pytest.mark.parametrize("place", SIX, ids=".".join)
@pytest.mark.parametrize("value", [[1.0] * 5, [1.0] * 7, 3.0, "1 2 3 4 5 6", None, {"joint_1": 1.0}])
def test_a_list_that_is_not_six_numbers_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """A list of another length, a single number or a text is refused with what was given."""
    path = edited_yaml(shipped_files.drives, place, value)
    assert f"{'.'.join(place)} is {value!r}; accepted: 6 numbers" in refusal(path)


@pytest.mark.parametrize("place", ONE, ids=".".join)
@pytest.mark.parametrize("value", [*WRONG, [1.0], 0.0])
def test_a_bad_single_value_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """A single value out of its range is refused by file, key and value."""
    path = edited_yaml(shipped_files.drives, place, value)
    assert f"{'.'.join(place)} is {value!r};" in refusal(path)


@pytest.mark.parametrize("counts", [15, 65536.0, 2**31])
def test_encoder_counts_are_a_whole_number_in_range(
    shipped_files: RobotFiles, edited_yaml: Edit, counts: float
) -> None:
    """Encoder counts that are not an integer in the accepted range are refused."""
    path = edited_yaml(shipped_files.drives, ("encoder", "counts_per_revolution"), counts)
    assert f"encoder.counts_per_revolution is {counts!r}; accepted: an integer in" in refusal(path)


@pytest.mark.parametrize("place", SIX + ONE, ids=".".join)
def test_a_missing_key_is_refused(shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]) -> None:
    """Without one of its keys the file is refused by that key."""
    path = edited_yaml(shipped_files.drives, place, None, remove=True)
    assert f"{'.'.join(place)} is missing" in refusal(path)


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
