"""The launch file against what it names; launch itself is not in the pip environment and stands in as a stub."""

from __future__ import annotations

import ast
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest

from rx90_common.base import share
from rx90_common.base.share import config_path
from rx90_emulator.cli.frame import EXECUTABLES

REPOSITORY = Path(__file__).resolve().parents[2]


class Action(NamedTuple):
    """A stub of anything that a launch file builds: what it was given."""

    kind: str
    given: tuple[Any, ...]
    named: dict[str, Any]


def described(monkeypatch: pytest.MonkeyPatch) -> list[Action]:
    """Return the actions of the launch file's description."""
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
    }
    for module, kinds in names.items():
        stub = ModuleType(module)
        for kind in kinds:
            setattr(stub, kind, lambda *given, kind=kind, **named: Action(kind, given, named))
        monkeypatch.setitem(sys.modules, module, stub)
    file = runpy.run_path(str(REPOSITORY / "launch" / "friction_bench.launch.py"))
    (actions,) = file["generate_launch_description"]().given
    return list(actions)


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
    """Package, executable and parameters exist, and every argument's default is the node's own."""
    *arguments, node = described(monkeypatch)
    assert node.kind == "Node"
    assert node.named["package"] == ElementTree.parse(REPOSITORY / "package.xml").findtext("name")
    assert node.named["executable"] in EXECUTABLES
    parameters = declared_parameters()
    (given,) = node.named["parameters"]
    assert set(given) <= set(parameters)
    for name, configuration in given.items():
        assert configuration == Action("LaunchConfiguration", (name,), {})
    assert {a.given[0]: a.named["default_value"] for a in arguments} == {name: parameters[name] for name in given}
    assert config_path(parameters["rig"]).is_file()
