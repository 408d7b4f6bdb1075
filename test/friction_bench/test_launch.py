"""The launch file against what it names; launch itself is not in the pip environment and stands in as a stub."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from launch_stub import arguments, build, ending, parameters

from rx90_common.base import share
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import EXECUTABLES

REPOSITORY = Path(__file__).resolve().parents[2]


def declared_parameters() -> dict[str, Any]:
    """Return the node's parameters as its source declares them, with defaults that are constants."""
    tree = ast.parse((REPOSITORY / "friction_bench" / "node" / "bench_node.py").read_text())
    constants = vars(share) | {
        node.targets[0].id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.Constant)
    }
    found = {}
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "declare":
            name, default = call.args[1], call.args[2]
            assert isinstance(name, ast.Constant)
            value = constants.get(default.id) if isinstance(default, ast.Name) else getattr(default, "value", None)
            found[name.value] = value
    return found


def test_launch_file_starts_the_node_with_parameters_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Package, executable and parameters exist, every default is the node's own, and its end is the launch's."""
    actions = build(monkeypatch, "friction_bench.launch.py")
    (node,) = (action for action in actions if action.kind == "Node")
    assert node.named["package"] == ElementTree.parse(REPOSITORY / "package.xml").findtext("name")
    assert node.named["executable"] in EXECUTABLES
    declared = declared_parameters()
    given = parameters(node)
    assert given == {name: name for name in ("port", "rig", "seed")}
    assert arguments(actions) == {"namespace": ""} | {name: str(declared[name]) for name in given}
    assert node.named["namespace"].given == ("namespace",)
    assert config_path(declared["rig"]).is_file()
    answer = ending(node, 0)
    assert answer is not None
    assert answer.kind == "Shutdown"
