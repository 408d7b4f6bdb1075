"""The JSON schemas say what the readers accept; parameters of other controllers are left out or refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from config_samples import shipped, written
from jsonschema import Draft202012Validator
from schema_faults import schema_faults

from rx90_common.base.share import config_path
from rx90_controller.node.parameters import ControllerParameters
from rx90_emulator.configuration.check import kind_named
from rx90_emulator.configuration.kinds import KINDS, NODE_PARAMETERS
from rx90_emulator.configuration.nodes import node_faults
from tools import schemas


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Path]]:
    """A good file, or several, of every kind."""
    return shipped() + written(tmp_path_factory.mktemp("samples"))


def test_the_shipped_schemas_are_those_of_the_readers() -> None:
    """The files in config/schemas/ are what `python -m tools.schemas` writes, and are schemas of draft 2020-12."""
    shipped_texts = {path.name: path.read_text(encoding="utf-8") for path in config_path("schemas").iterdir()}
    assert shipped_texts == schemas.texts()
    for kind in KINDS:
        Draft202012Validator.check_schema(kind.json_schema())


def test_good_files_fit_their_schemas(samples: list[tuple[str, Path]]) -> None:
    """Shipped files and those of every other kind are read, and fit their schemas; the nodes' have none."""
    assert {kind for kind, _ in samples} == {*(kind.name for kind in KINDS), NODE_PARAMETERS}
    for kind, path in samples:
        kind_named(kind).read(path)
        assert kind == NODE_PARAMETERS or schema_faults(kind, path) == [], path


def test_what_joint_trajectory_controller_alone_has_is_taken_out() -> None:
    """Its parameters without a counterpart are no parameters of the node, nor unknown."""
    joints = [f"joint_{k}" for k in (6, 1, 2, 3, 4, 5)]
    given = {"joints": joints, "gains.joint_1.p": 1.0, "cmd_timeout": 0.0}
    assert node_faults("rx90_controller", given) == []
    assert ControllerParameters.of(given) == ControllerParameters.of({})
    for name in ("gain", "interpolation_methods", "joint"):
        (line,) = node_faults("rx90_controller", {name: 1.0})
        assert line.startswith(f"{name} is not a known key")
