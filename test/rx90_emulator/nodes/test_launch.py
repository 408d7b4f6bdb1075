"""The launch file of the nodes; launch itself is not in the pip environment and stands in as a stub."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from rx90_common.description.robot_files import SHIPPED

FILE = Path(__file__).resolve().parents[3] / "launch" / "rx90.launch.py"


class Action(NamedTuple):
    """A stub of anything that a launch file builds: what it was given."""

    kind: str
    given: tuple[Any, ...]
    named: dict[str, Any]


def test_the_launch_file_hands_each_robot_file_to_its_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file that describes the robot is an argument with its shipped name, and a parameter of who reads it.

    In one process, each parameter is given to its own node.
    """
    names = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.conditions": ["IfCondition", "UnlessCondition"],
        "launch.substitutions": ["LaunchConfiguration", "OrSubstitution"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
    }
    for module, kinds in names.items():
        stub = ModuleType(module)
        for kind in kinds:
            setattr(stub, kind, lambda *given, kind=kind, **named: Action(kind, given, named))
        monkeypatch.setitem(sys.modules, module, stub)
    (actions,) = runpy.run_path(str(FILE))["generate_launch_description"]().given
    arguments = {a.given[0]: a.named["default_value"] for a in actions if a.kind == "DeclareLaunchArgument"}
    files = {name: file for name, file in SHIPPED.items() if name != "urdf"}
    assert {name: arguments[name] for name in files} == files
    nodes = {
        a.named["executable"]: a.named["parameters"][0].keys()
        for a in actions
        if a.kind == "Node" and a.named.get("parameters")
    }
    assert {"tool", "drives", "friction"} <= nodes["rx90_sim"]
    assert {"drives", "controller"} <= nodes["rx90_controller"]
    (cell,) = (a.named for a in actions if a.kind == "Node" and a.named["executable"] == "rx90_cell")
    options, values = cell["ros_arguments"][::2], cell["ros_arguments"][1::2]
    assert set(options) == {"-p"}
    assert {head + argument.given[0] for head, argument in values} == {
        f"{node}:{name}:={name}" for node in ("rx90_sim", "rx90_controller") for name in nodes[node]
    }
