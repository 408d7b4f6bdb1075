"""The launch file of the nodes; launch itself is not in the pip environment and stands in as a stub."""

from __future__ import annotations

import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml
from launch_stub import Action, Context, arguments, build, ending

from rx90_common.base.share import config_path
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DEFAULT_ROBOT, MODEL_FILES, RobotFiles
from rx90_common.process import interrupts

FILE, MOVEIT = "rx90.launch.py", "moveit.launch.py"


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
        *("autostart", "velocities_from_positions"),
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
    other = ("robot", "urdf", "drives", "controller", "velocities_from_positions")
    assert sections == {
        "/**/rx90_sim": {"ros__parameters": {name: name for name in ("autostart", *own)}},
        "/**/rx90_controller": {"ros__parameters": {name: name for name in ("autostart", *other)}},
    }


def test_robot_state_publisher_gets_the_robot_with_its_tool(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is started with the links tool and tcp of the tool that the simulation gets, and with none without a tool."""
    (opaque,) = (action for action in build(monkeypatch, FILE) if action.kind == "OpaqueFunction")
    for tool, links in (("", {"tool", "tcp"}), ("none", set())):
        (node,) = opaque.named["function"](Context({"robot": DEFAULT_ROBOT, "urdf": "", "tool": tool}))
        (given,) = node.named["parameters"]
        robot = ET.fromstring(given["robot_description"].given[0])
        names = {link.get("name") for link in robot.findall("link")}
        assert names & {"tool", "tcp"} == links
        assert names >= {"base_link", "tool0"}


def test_moveit_gets_the_robot_its_limits_and_the_controller(monkeypatch: pytest.MonkeyPatch) -> None:
    """move_group and RViz get URDF, SRDF, limits and planners; the arm comes after them, without its own RViz."""
    opaque, arm = build(monkeypatch, MOVEIT)[-2:]
    group, rviz = opaque.named["function"](Context({"robot": "tx40", "urdf": "", "tool": ""}))
    given, execution, _ = group.named["parameters"]
    assert rviz.named["parameters"] == [given]
    urdf, srdf = (ET.fromstring(given[f"robot_description{end}"].given[0]) for end in ("", "_semantic"))
    assert urdf.get("name") == srdf.get("name") == "tx40"
    planning = given["robot_description_planning"]
    assert planning["joint_limits"].keys() == {joint.get("name") for joint in urdf.findall("joint[@type='revolute']")}
    assert planning["cartesian_limits"].keys() == {"max_trans_vel", "max_trans_acc", "max_trans_dec", "max_rot_vel"}
    assert given["robot_description_kinematics"].keys() == {"manipulator"}
    for pipeline in given["planning_pipelines"]:
        assert given[pipeline]["planning_plugins"]
    assert given["use_sim_time"] is True
    controllers = execution["moveit_simple_controller_manager"]
    assert controllers["controller_names"] == ["rx90_controller"]
    assert set(controllers["rx90_controller"]["joints"]) == planning["joint_limits"].keys()
    for node in (group, rviz):
        assert ("/tf", "tf") in node.named["remappings"]
        assert node.named["namespace"] == Action("LaunchConfiguration", ("namespace",), {})
    assert Path(rviz.named["arguments"][1]).is_file()
    assert Path(arm.given[0].given[0]).name == FILE
    assert dict(arm.named["launch_arguments"]) == {
        "robot_state_publisher": "true",
        "rviz": "false",
        "velocities_from_positions": "true",
    }


def test_moveit_refuses_what_its_files_are_not_made_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Another tool than the folder's, and a folder without MoveIt's files, are one line with what is accepted."""
    opaque = build(monkeypatch, MOVEIT)[-2]
    with pytest.raises(RuntimeError, match=r"tool:=none: .*; accepted: robot:=FOLDER with that tool"):
        opaque.named["function"](Context({"robot": DEFAULT_ROBOT, "tool": "none"}))
    own = tmp_path / "arm"
    shutil.copytree(config_path("robots/tx40"), own)
    shutil.rmtree(own / "moveit")
    with pytest.raises(RuntimeError, match=r"joint_limits.yaml is missing; accepted: .*python -m tools.moveit_files"):
        opaque.named["function"](Context({"robot": str(own)}))


def test_rviz_shows_frames_and_groups_that_there_are() -> None:
    """Both RViz files are YAML whose frames are links of the robot, and whose group is that of the SRDF."""
    robot = load_robot(RobotFiles().urdf, RobotFiles().tool)
    links = {link.get("name") for link in ET.fromstring(robot.urdf).findall("link")}
    for name in ("rx90", "moveit"):
        shown = yaml.safe_load(config_path(f"rviz/{name}.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
        displays = {display["Name"]: display for display in shown["Displays"]}
        frames = set(displays["TF"]["Frames"]) - {"All Enabled"} if "TF" in displays else set()
        frames |= {shown["Global Options"]["Fixed Frame"], shown["Views"]["Current"]["Target Frame"]}
        assert frames <= links
    group = displays["MotionPlanning"]["Planning Request"]["Planning Group"]
    semantic = ET.parse(config_path("robots/rx90b/moveit/robot.srdf"))
    assert group in {element.get("name") for element in semantic.findall("group")}


@pytest.mark.parametrize(("code", "left_with"), [(2, 2), (-9, 137), (0, 0)])
def test_a_node_that_ends_ends_the_launch_with_its_code(
    monkeypatch: pytest.MonkeyPatch, code: int, left_with: int
) -> None:
    """Each node's end shuts the launch down; the first code that is not 0 stays; ended by the launch, none counts."""
    left: list[int] = []
    monkeypatch.setattr(interrupts, "_codes", left)
    monkeypatch.setattr(interrupts.atexit, "register", lambda _: None)
    made = nodes(build(monkeypatch, FILE))
    assert ending(made["rx90_sim"], 3, shutting_down=True) is None
    for node in (made["rx90_controller"], made["rx90_cell"]):
        answer = ending(node, code)
        assert answer is not None
        assert answer.kind == "Shutdown"
    assert left == ([left_with] if code else [])
