"""The parameters that files are checked against are those of the nodes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from rx90_common.base.errors import ConfigError
from rx90_emulator.configuration.nodes import NODES, declared

PAGE = Path(__file__).resolve().parents[3] / "docs/reference/parameters.md"


@pytest.mark.parametrize("node", NODES)
def test_declared_parameters_are_those_of_running_nodes(node: str) -> None:
    """Name, default and range of each parameter are those in the page that is written from nodes that run."""
    text = PAGE.read_text(encoding="utf-8")
    table = re.search(rf"<!-- parameters of {node} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert table is not None
    rows = re.findall(r"^\| `([^`]+)` \| `([^`]*)` \| ([^|]*) \|", table[1], re.MULTILINE)
    joints = [f"joint_{k}" for k in range(1, 7)]
    every = [(name.replace("<joint>", joint), *rest) for name, *rest in rows for joint in joints]
    parameters = declared(node)
    assert {name for name, *_ in every} == set(parameters.entries)
    for name, default, accepted in every:
        assert parameters.values[name] == yaml.safe_load(default), name
        rules = parameters.entries[name].rules()
        ends = re.fullmatch(r"([\d.,e-]+) to ([\d.,e+]+)", accepted.strip())
        if ends is not None:
            assert (rules["minimum"], rules["maximum"]) == tuple(float(end.replace(",", "")) for end in ends.groups())


def test_what_joint_trajectory_controller_alone_has_is_taken_out() -> None:
    """Its parameters without a counterpart are no parameters of the node, nor unknown; joints of another arm are."""
    joints = [f"joint_{k}" for k in (6, 1, 2, 3, 4, 5)]
    parameters = declared("rx90_controller", {"joints": joints, "gains.joint_1.p": 1.0, "cmd_timeout": 0.0})
    assert parameters.values == declared("rx90_controller").values
    with pytest.raises(ConfigError, match=r"parameter joints is \['axis_1'\]; accepted: joint_1, .*, in any order"):
        declared("rx90_controller", {"joints": ["axis_1"]})
    for name in ("gain.joint_1.p", "interpolation_methods", "joint"):
        with pytest.raises(ConfigError, match=f"parameter {name} is unknown to rx90_controller"):
            declared("rx90_controller", {name: 1.0})
