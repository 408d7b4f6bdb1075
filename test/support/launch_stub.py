"""What a launch file builds, without launch, which pip does not have: stubs note what they are given."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest

LAUNCH = Path(__file__).resolve().parents[2] / "launch"
_STUBS = {
    "launch": ["Action", "Condition", "LaunchContext", "LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument", "IncludeLaunchDescription", "OpaqueFunction", "Shutdown"],
    "launch.conditions": ["IfCondition", "UnlessCondition"],
    "launch.events": [],
    "launch.events.process": ["ProcessExited"],
    "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
    "launch.substitutions": ["LaunchConfiguration", "OrSubstitution"],
    "launch_ros": [],
    "launch_ros.actions": ["Node"],
    "launch_ros.parameter_descriptions": ["ParameterFile", "ParameterValue"],
}


class Action(NamedTuple):
    kind: str
    given: tuple[Any, ...]
    named: dict[str, Any]

    def perform(self, context: Context) -> str:
        return context.launch_configurations[self.given[0]]


class Context(NamedTuple):
    launch_configurations: dict[str, str]


def build(monkeypatch: pytest.MonkeyPatch, file: str) -> list[Action]:
    for module, kinds in _STUBS.items():
        stub = ModuleType(module)
        for kind in kinds:
            make = type(kind, (), {"__new__": lambda _, *given, kind=kind, **named: Action(kind, given, named)})
            setattr(stub, kind, make)
        monkeypatch.setitem(sys.modules, module, stub)
    (actions,) = runpy.run_path(str(LAUNCH / file))["generate_launch_description"]().given
    return list(actions)


def arguments(actions: list[Action]) -> dict[str, str]:
    declared = [action for action in actions if action.kind == "DeclareLaunchArgument"]
    assert all(action.named["description"] for action in declared)
    return {action.given[0]: action.named["default_value"] for action in declared}


def parameters(node: Action) -> dict[str, str]:
    (given,) = node.named["parameters"]
    return {name: value.given[0].given[0] for name, value in given.items()}


def ending(node: Action, code: int, shutting_down: bool = False) -> Action | None:
    event = SimpleNamespace(returncode=code, process_name="node-1")
    answer: Action | None = node.named["on_exit"](event, SimpleNamespace(is_shutdown=shutting_down))
    return answer
