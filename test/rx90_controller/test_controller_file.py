"""The controller file: the files beside it that a model needs, and whose joints and interfaces it may name."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refusal_by

from rx90_common.base.errors import ConfigError
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.law.parameters import load_controller
from rx90_controller.node.parameters import ControllerParameters
from rx90_emulator.loop.setup import Setup

Edit = Callable[..., Path]
MODEL_SWITCHES = [("feed_forward", key) for key in ("inverse_dynamics", "friction_model")]


def refusal(path: Path) -> str:
    return refusal_by(load_controller, path)


@pytest.mark.parametrize("place", MODEL_SWITCHES, ids=".".join)
def test_a_model_takes_the_files_beside(shipped_files: RobotFiles, edited_yaml: Edit, place: tuple[str, str]) -> None:
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
    assert (law.model.path("friction"), law.model.path("tool")) == (path.parent / "friction.yaml", None)


def test_the_model_s_files_may_be_named(shipped_files: RobotFiles, edited_yaml: Edit, tmp_path: Path) -> None:
    """A named file is beside the controller file or below config/; what is wrong in it is refused in any case."""
    shared = {role: shipped_files.text(role) for role in ("urdf", "drives", "friction")}
    other = tmp_path / "other.yaml"
    other.write_bytes(shipped_files.friction.read_bytes())
    block = {**shared, "tool": "none", "friction": "other.yaml", "note": "of another arm"}
    named = edited_yaml(shipped_files.controller, ("model",), block)
    model = load_controller(named).model
    assert [model.path(role) for role in ("tool", "friction", "drives")] == [None, other, shipped_files.drives]
    said = refusal(edited_yaml(shipped_files.controller, ("model",), {**shared, "friction": "nowhere.yaml"}))
    accepted = "a friction file: a path from this file's folder"
    assert f"model.friction is 'nowhere.yaml'; accepted: {accepted}" in said
    whole = other.read_text()
    other.write_text(whole.replace("tau_c: 25.0", "tau_c: -25.0"))
    said = refusal(edited_yaml(shipped_files.controller, ("model",), {**shared, "friction": "other.yaml"}))
    assert f"{other}: elements.joint_1.tau_c is -25.0; accepted" in said


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("joints", ["joint_1", "elbow"], "joint_1, joint_2, joint_3, joint_4, joint_5, joint_6"),
        ("command_interfaces", ["effort"], "position"),
        ("state_interfaces", "position", "position, velocity"),
    ],
)
def test_a_file_for_another_controller_is_refused(name: str, value: Any, said: str) -> None:
    """Joints and interfaces of a file for joint_trajectory_controller are the arm's."""
    with pytest.raises(ConfigError) as refused:
        ControllerParameters.of({name: value})
    assert str(refused.value) == f"parameter {name} is {value!r}; accepted: {said}, in any order"


def test_a_file_for_this_arm_is_taken(shipped: Setup) -> None:
    mine = {"joints": list(reversed(shipped.robot.joint_names)), "state_interfaces": ["velocity", "position"]}
    taken = ControllerParameters.of({**mine, "command_interfaces": ["position"], "update_rate": 100})
    assert taken == ControllerParameters.of({})
