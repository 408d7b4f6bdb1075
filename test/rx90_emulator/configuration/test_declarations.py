"""The JSON schemas say what the readers accept, and each value refuses what its declaration excludes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from config_samples import EVERY_KIND, shipped, written
from jsonschema import Draft202012Validator
from schema_faults import schema_faults

from rx90_common.base.config import read_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.parameters import leaves
from rx90_emulator.configuration.check import kind_named
from rx90_emulator.configuration.nodes import NODES, node_values
from tools import schemas

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Path]]:
    """A good file, or several, of every kind."""
    return shipped() + written(tmp_path_factory.mktemp("samples"))


def test_the_shipped_schemas_are_those_of_the_readers() -> None:
    """The files in config/schemas/ are what `python -m tools.schemas` writes, and are schemas of draft 2020-12."""
    shipped_texts = {path.name: path.read_text(encoding="utf-8") for path in config_path("schemas").iterdir()}
    assert shipped_texts == schemas.texts()
    for kind in EVERY_KIND:
        Draft202012Validator.check_schema(kind.json_schema())


def test_good_files_fit_their_schemas(samples: list[tuple[str, Path]]) -> None:
    """Shipped files and those of every other kind are read, and fit their schemas."""
    assert {kind for kind, _ in samples} == {kind.name for kind in EVERY_KIND}
    for kind, path in samples:
        kind_named(kind).read(path)
        assert schema_faults(kind, path) == [], path


@pytest.mark.parametrize("node", NODES)
def test_declared_parameters_are_those_of_running_nodes(node: str) -> None:
    """Name, default and range of each parameter are those in the page that is written from nodes that run."""
    text = (ROOT / "docs/reference/parameters.md").read_text(encoding="utf-8")
    table = re.search(rf"<!-- parameters of {node} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert table is not None
    rows = re.findall(r"^\| `([^`]+)` \| `([^`]*)` \| ([^|]*) \|", table[1], re.MULTILINE)
    joints = [f"joint_{k}" for k in range(1, 7)]
    every = [(name.replace("<joint>", joint), *rest) for name, *rest in rows for joint in joints]
    parameters = {name: (value, field) for name, value, field in leaves(node_values(node, {}))}
    # What the robot says, and nobody chooses, is compared with it instead: see the next test.
    arms = ("joints", "command_interfaces", "state_interfaces")
    every = [row for row in every if row[0] not in arms]
    assert {name for name, *_ in every} == parameters.keys() - {*arms}
    for name, default, accepted in every:
        value, field = parameters[name]
        assert value == tuple(found) if isinstance(found := yaml.safe_load(default), list) else value == found, name
        ends = re.fullmatch(r"([\d.,e-]+) to ([\d.,e+]+)", accepted.strip())
        if ends is not None:
            bounds = [rule.ge if hasattr(rule, "ge") else rule.le for rule in field.metadata]
            assert bounds == [float(end.replace(",", "")) for end in ends.groups()]


def test_what_joint_trajectory_controller_alone_has_is_taken_out() -> None:
    """Its parameters without a counterpart are no parameters of the node, nor unknown."""
    joints = [f"joint_{k}" for k in (6, 1, 2, 3, 4, 5)]
    given = {"joints": joints, "gains.joint_1.p": 1.0, "cmd_timeout": 0.0}
    assert node_values("rx90_controller", given) == node_values("rx90_controller", {})
    for name in ("gain", "interpolation_methods", "joint"):
        with pytest.raises(ConfigError, match=f"parameter {name} is not a known key"):
            node_values("rx90_controller", {name: 1.0})


def test_the_shipped_values_say_that_they_are_assumed(shipped_files: RobotFiles) -> None:
    """Each block of the RX90B's controller and drives carries its provenance; the controller's are assumed."""
    said = {
        role: [block["provenance"] for block in read_yaml(getattr(shipped_files, role)).values()]
        for role in ("controller", "drives")
    }
    assert set(said["controller"]) == {"assumed"}
    assert None not in said["drives"]
