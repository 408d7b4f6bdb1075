"""The controller file: every key refuses what it cannot be, in one line that names it."""

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
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.law.parameters import CS7BParameters, load_controller
from rx90_emulator.loop.setup import Setup

Edit = Callable[..., Path]
POSITIVE_SIX = [
    ("servo", "inertia"),
    ("current_loop", "slew_rate"),
    ("supervision", "following_error"),
    ("trajectory", "max_acceleration"),
]
SIX = [
    *POSITIVE_SIX,
    ("servo", "kp"),
    ("servo", "kv"),
    ("servo", "ki"),
    ("servo", "integrator_limit"),
    ("feed_forward", "coulomb_torque"),
    ("feed_forward", "viscous_friction"),
]
POSITIVE_ONE = [("feed_forward", "coulomb_velocity"), ("current_loop", "bandwidth"), ("supervision", "over_speed")]
ONE = [*POSITIVE_ONE, ("trajectory", "start_tolerance")]
SWITCHES = [("feed_forward", key) for key in ("velocity", "acceleration", "coulomb", "viscous")]
MODEL_SWITCHES = [("feed_forward", key) for key in ("inverse_dynamics", "friction_model")]


def refusal(path: Path) -> str:
    """Return the one line with which the file is refused."""
    return refusal_by(load_controller, path)


def test_these_are_all_keys(shipped_files: RobotFiles) -> None:
    """The lists above name every key of the shipped file, so that none goes untested."""
    data = yaml.safe_load(shipped_files.controller.read_text())
    keys = [(block, key) for block in data for key in data[block] if key not in {"source", "provenance"}]
    assert sorted(keys) == sorted(SIX + ONE + SWITCHES + MODEL_SWITCHES)


@pytest.mark.parametrize("place", SIX, ids=".".join)
@pytest.mark.parametrize("value", [-1.5, math.nan, math.inf, "strong", None, True])
def test_a_bad_value_in_a_list_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """One bad number of six is refused by file, key, index and value."""
    assert f"{'.'.join(place)}[5] is {value!r};" in refusal(edited_yaml(shipped_files.controller, (*place, 5), value))


@pytest.mark.parametrize("place", SIX, ids=".".join)
def test_a_list_that_is_not_six_numbers_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]
) -> None:
    """A list of another length, a single number or a text is refused with what was given."""
    for value in ([1.0] * 5, [1.0] * 7, 3.0, "1 2 3 4 5 6", None):
        said = refusal(edited_yaml(shipped_files.controller, place, value))
        assert f"{'.'.join(place)} is {value!r}; accepted: 6 numbers" in said


@pytest.mark.parametrize("place", ONE, ids=".".join)
@pytest.mark.parametrize("value", [-1.5, math.nan, math.inf, "strong", None, True, [1.0]])
def test_a_bad_single_value_is_refused(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """A single value out of its range is refused by file, key and value."""
    assert f"{'.'.join(place)} is {value!r};" in refusal(edited_yaml(shipped_files.controller, place, value))


@pytest.mark.parametrize("place", POSITIVE_SIX + POSITIVE_ONE, ids=".".join)
def test_zero_is_refused_where_it_means_nothing(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]
) -> None:
    """Zero is refused for what is divided by or would stop the amplifier."""
    where = (*place, 0) if place in POSITIVE_SIX else place
    assert "is 0.0;" in refusal(edited_yaml(shipped_files.controller, where, 0.0))


@pytest.mark.parametrize("place", SWITCHES + MODEL_SWITCHES, ids=".".join)
@pytest.mark.parametrize("value", [1, 0.0, "maybe", None])
def test_a_switch_is_true_or_false(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str], value: Any
) -> None:
    """A switch that is neither true nor false is refused."""
    said = refusal(edited_yaml(shipped_files.controller, place, value))
    assert f"{'.'.join(place)} is {value!r}; accepted: true or false" in said


def test_the_viscous_exponents_may_be_left_out(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """Without them all are 1; six numbers in [0.3, 2] are taken, others are refused by key, index and value."""
    assert load_controller(shipped_files.controller).viscous_exponent.tolist() == [1.0] * 6
    place, good = ("feed_forward", "viscous_exponent"), [0.3, 0.6, 0.7, 1.0, 1.5, 2.0]
    read = load_controller(edited_yaml(shipped_files.controller, place, good))
    assert read.viscous_exponent.tolist() == good
    for bad in (0.0, -0.6, 0.29, 2.01, math.nan, "half"):
        said = refusal(edited_yaml(shipped_files.controller, place, [*good[:5], bad]))
        assert f"feed_forward.viscous_exponent[5] is {bad!r}; accepted: 6 numbers, each a number in [0.3, 2]" in said
    said = refusal(edited_yaml(shipped_files.controller, place, 0.6))
    assert "feed_forward.viscous_exponent is 0.6; accepted: 6 numbers" in said


@pytest.mark.parametrize("place", SIX + ONE + SWITCHES, ids=".".join)
def test_a_missing_key_is_refused(shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]) -> None:
    """Without one of its keys the file is refused by that key."""
    said = refusal(edited_yaml(shipped_files.controller, place, None, remove=True))
    assert f"{'.'.join(place)} is missing" in said


@pytest.mark.parametrize("block", ["servo", "feed_forward", "current_loop", "supervision", "trajectory"])
def test_a_block_is_checked(shipped_files: RobotFiles, edited_yaml: Edit, block: str) -> None:
    """A missing block, a block that is no mapping and an unknown key in it are refused by name."""
    source = shipped_files.controller
    assert f"{block} is missing" in refusal(edited_yaml(source, (block,), None, remove=True))
    assert f"{block} is [1]; accepted: a mapping" in refusal(edited_yaml(source, (block,), [1]))
    assert f"{block}.gain is not a known key" in refusal(edited_yaml(source, (block, "gain"), 1.0))
    assert "servos is not a known key" in refusal(edited_yaml(source, ("servos",), {}))


def test_a_key_that_stands_twice_is_refused(shipped_files: RobotFiles, tmp_path: Path) -> None:
    """A repeated key is refused: its first value would be lost silently."""
    path = tmp_path / "cs7b.yaml"
    path.write_text(shipped_files.controller.read_text() + "\ntrajectory:\n  start_tolerance: 2.0\n")
    with pytest.raises(ConfigError, match="'trajectory' stands twice"):
        load_controller(path)


@pytest.mark.parametrize(
    "name", [f.name for f in dataclasses.fields(CS7BParameters) if f.name not in {"feed_forward", "model"}]
)
@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_parameters_built_in_python_are_checked(shipped: Setup, name: str, bad: float) -> None:
    """CS7BParameters refuses negative and undefined values by name when no file is involved."""
    value = getattr(shipped.controller, name) * 0 + bad
    with pytest.raises(ConfigError, match=rf"controller: {name}(\[0\])? is .*; accepted"):
        dataclasses.replace(shipped.controller, **{name: value})


def test_the_shipped_values_say_that_they_are_assumed(shipped_files: RobotFiles) -> None:
    """The blocks with values carry their provenance; none of them is called published."""
    data = yaml.safe_load(shipped_files.controller.read_text())
    for block in ("servo", "feed_forward", "current_loop", "supervision", "trajectory"):
        assert data[block]["provenance"] == "assumed"
    assert np.all(load_controller(shipped_files.controller).inertia > 0)


@pytest.mark.parametrize("place", MODEL_SWITCHES, ids=".".join)
def test_what_needs_a_model_takes_the_files_beside(
    shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]
) -> None:
    """The parts by a model are off where they are left out; on, the files beside are read, a missing one is refused."""
    switch = place[1]
    left_out = load_controller(edited_yaml(shipped_files.controller, place, None, remove=True))
    assert not getattr(left_out.feed_forward, switch)
    path = edited_yaml(shipped_files.controller, place, True)
    assert "needs" in (said := refusal(path))
    assert f"{path.parent}/robot.urdf, which is not there; accepted: robot.urdf beside" in said
    for role in ("urdf", "drives", "friction"):
        source = getattr(shipped_files, role)
        (path.parent / source.name).write_bytes(source.read_bytes())
    law = load_controller(path)
    assert getattr(law.feed_forward, switch)
    assert law.model is not None
    assert (law.model.friction, law.model.tool) == (path.parent / "friction.yaml", None)


def test_named_files_do_not_depend_on_where_a_program_is_started(
    shipped_files: RobotFiles, edited_yaml: Edit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder that was moved away from its model, a file of that name in the present folder is not taken for it."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in (elsewhere, tmp_path):
        (folder / "mine.yaml").write_bytes(shipped_files.friction.read_bytes())
    monkeypatch.chdir(elsewhere)
    shared = {role: str(getattr(shipped_files, role)) for role in ("urdf", "drives")}
    named = edited_yaml(shipped_files.controller, ("model",), {**shared, "friction": "mine.yaml"})
    model = load_controller(named).model
    assert model is not None
    assert model.friction == named.parent / "mine.yaml"
    model.friction.unlink()
    accepted = "a friction file: a path from this file's folder or from config/, or an absolute one"
    assert f"model.friction is 'mine.yaml'; accepted: {accepted}" in refusal(named)


def test_the_model_s_files_may_be_named(shipped_files: RobotFiles, edited_yaml: Edit, tmp_path: Path) -> None:
    """A named file is beside the controller file or below config/; what is wrong in it is refused in any case."""
    shared = {role: shipped_files.text(role) for role in ("urdf", "drives", "friction")}
    other = tmp_path / "other.yaml"
    other.write_bytes(shipped_files.friction.read_bytes())
    named = edited_yaml(shipped_files.controller, ("model",), {**shared, "tool": "none", "friction": "other.yaml"})
    model = load_controller(named).model
    assert model is not None
    assert (model.tool, model.friction, model.drives) == (None, other, shipped_files.drives)
    for role, name, accepted in (
        ("friction", "nowhere.yaml", "is 'nowhere.yaml'; accepted: a friction file: a path from this file's folder"),
        ("drives", 3, "is 3; accepted: a text"),
        ("gears", "x", "is not a known key; accepted: drives, friction, tool, urdf"),
    ):
        said = refusal(edited_yaml(shipped_files.controller, ("model",), {**shared, role: name}))
        assert f"model.{role} {accepted}" in said
    whole = other.read_text()
    other.write_text(whole.replace("{tau_c: 25.0", "{load: {driving: -0.1, driven: 0.1}, tau_c: 25.0"))
    said = refusal(edited_yaml(shipped_files.controller, ("model",), {**shared, "friction": "other.yaml"}))
    assert f"{other}: elements.joint_1.load.driving is -0.1; accepted" in said
    other.write_text(whole.replace("tau_c: 25.0", "tau_c: -25.0"))
    said = refusal(edited_yaml(shipped_files.controller, ("model",), {**shared, "friction": "other.yaml"}))
    assert f"{other}: elements.joint_1.tau_c is -25.0; accepted" in said


@pytest.mark.parametrize("switch", ["inverse_dynamics", "friction_model"])
def test_without_a_model_its_parts_stay_off(shipped: Setup, switch: str) -> None:
    """Parameters built in Python without a model refuse the parts that need one."""
    on = dataclasses.replace(shipped.controller.feed_forward, **{switch: True})
    with pytest.raises(ConfigError, match=f"{switch} is true without a model; accepted: with one"):
        dataclasses.replace(shipped.controller, feed_forward=on, model=None)
