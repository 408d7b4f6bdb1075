"""The launch file of the nodes; launch itself is not in the pip environment and stands in as a stub."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml
from launch_stub import Action, arguments, build, ending

from rx90_common.description.robot_files import DEFAULT_ROBOT, MODEL_FILES
from rx90_common.process import exit_code

FILE = "rx90.launch.py"


def nodes(actions: list[Action]) -> dict[str, Action]:
    """Return the nodes by their executables."""
    return {action.named["executable"]: action for action in actions if action.kind == "Node"}


def test_arguments_are_parameters_of_the_nodes_that_read_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files, time mode, pace, start and namespace are arguments with the nodes' defaults, and reach their nodes."""
    actions = build(monkeypatch, FILE)
    defaults, made = arguments(actions), nodes(actions)
    assert {name: defaults[name] for name in MODEL_FILES} == dict.fromkeys(MODEL_FILES, "")  # the robot's
    assert defaults["robot"] == DEFAULT_ROBOT
    assert defaults.keys() - MODEL_FILES == {
        *("robot", "namespace", "time_mode", "real_time_factor", "initial_position", "paused", "composed"),
        *("robot_state_publisher", "rviz"),
    }
    for node in made.values():
        assert node.named["namespace"] == Action("LaunchConfiguration", ("namespace",), {})
        assert ("/clock", "clock") in node.named["remappings"]
    for executable in ("rx90_sim", "rx90_controller", "rx90_cell"):
        (file,) = made[executable].named["parameters"]
        assert file.named == {"allow_substs": True}
    text = Path(file.given[0]).read_text(encoding="utf-8")
    sections = yaml.safe_load(re.sub(r"\$\(var (\w+)\)", r"\1", text))
    own = ("time_mode", "real_time_factor", "initial_position", "paused", "robot", "urdf", "tool", "drives", "friction")
    assert sections == {
        "/**/rx90_sim": {"ros__parameters": {name: name for name in own}},
        "/**/rx90_controller": {"ros__parameters": {name: name for name in ("robot", "urdf", "drives", "controller")}},
    }


def test_robot_state_publisher_gets_the_robot_with_its_tool(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is started with the links tool and tcp of the tool that the simulation gets, and with none without a tool."""
    (opaque,) = (action for action in build(monkeypatch, FILE) if action.kind == "OpaqueFunction")
    for tool, links in (("", {"tool", "tcp"}), ("none", set())):
        (node,) = opaque.named["function"]({"robot": DEFAULT_ROBOT, "urdf": "", "tool": tool})
        (given,) = node.named["parameters"]
        robot = ET.fromstring(given["robot_description"].given[0])
        names = {link.get("name") for link in robot.findall("link")}
        assert names & {"tool", "tcp"} == links
        assert names >= {"base_link", "tool0"}


@pytest.mark.parametrize(("code", "left_with"), [(2, 2), (-9, 137), (0, 0)])
def test_a_node_that_ends_ends_the_launch_with_its_code(
    monkeypatch: pytest.MonkeyPatch, code: int, left_with: int
) -> None:
    """Each node's end shuts the launch down; the first code that is not 0 stays; ended by the launch, none counts."""
    left: list[int] = []
    monkeypatch.setattr(exit_code, "_codes", left)
    monkeypatch.setattr(exit_code.atexit, "register", lambda _: None)
    made = nodes(build(monkeypatch, FILE))
    assert ending(made["rx90_sim"], 3, shutting_down=True) is None
    for node in (made["rx90_controller"], made["rx90_cell"]):
        answer = ending(node, code)
        assert answer is not None
        assert answer.kind == "Shutdown"
    assert left == ([left_with] if code else [])
