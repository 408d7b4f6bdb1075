"""The controller file: every key refuses what it cannot be, in one line that names it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from refusals import refusal_by

from rx90_common.base.entries import REQUIRED, Entry, Number, Numbers, Switch
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.law.parameters import CONTROLLER, CS7BParameters, load_controller
from rx90_emulator.loop.setup import Setup

Edit = Callable[..., Path]
KEYS: dict[str, Entry] = {
    f"{block}.{key}": entry
    for block, group in CONTROLLER.keys.items()
    if isinstance(group, Group) and block != "model"
    for key, entry in group.keys.items()
}
MODEL_SWITCHES = [("feed_forward", key) for key in ("inverse_dynamics", "friction_model")]


def refusal(path: Path) -> str:
    """Return the one line with which the file is refused."""
    return refusal_by(load_controller, path)


def refused_values(entry: Entry) -> Iterator[tuple[Any, str]]:
    """Yield values that a declaration does not accept, and what is said of them behind the key."""
    if isinstance(entry, Switch):
        yield from ((value, f" is {value!r}; accepted: true or false") for value in (1, 0.0, "maybe", None))
        return
    assert isinstance(entry, Number)
    bounded = math.isfinite(entry.high)
    beyond = [*([entry.low - 1.0] * math.isfinite(entry.low)), *([2.0 * entry.high, 1e308] * bounded)]
    bad: list[Any] = [*beyond, math.nan, math.inf, "strong", None, True, *([entry.low] * entry.above)]
    if isinstance(entry, Numbers):
        good = entry.high if bounded else 1.0
        yield from (([good] * 5 + [value], f"[5] is {value!r}; accepted: 6 numbers") for value in bad)
        bad = [[good] * 5, [good] * 7, good, "1 2 3 4 5 6", None]
        yield from ((value, f" is {value!r}; accepted: 6 numbers") for value in bad)
    else:
        yield from ((value, f" is {value!r}; accepted: ") for value in [*bad, [1.0]])


@pytest.mark.parametrize("name", KEYS)
def test_every_key_refuses_what_its_declaration_does_not_accept(
    shipped_files: RobotFiles, edited_yaml: Edit, name: str
) -> None:
    """One line names file, key, index, value and what is accepted; a key without a default is missed."""
    entry, place = KEYS[name], tuple(name.split("."))
    for value, words in refused_values(entry):
        assert f"{name}{words}" in refusal(edited_yaml(shipped_files.controller, place, value))
    if entry.default is REQUIRED:
        assert f"{name} is missing" in refusal(edited_yaml(shipped_files.controller, place, None, remove=True))


def test_the_viscous_exponents_may_be_left_out(shipped_files: RobotFiles, edited_yaml: Edit) -> None:
    """Without them all are 1; six numbers in [0.3, 2] are taken."""
    assert load_controller(shipped_files.controller).viscous_exponent.tolist() == [1.0] * 6
    place, good = ("feed_forward", "viscous_exponent"), [0.3, 0.6, 0.7, 1.0, 1.5, 2.0]
    assert load_controller(edited_yaml(shipped_files.controller, place, good)).viscous_exponent.tolist() == good


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
