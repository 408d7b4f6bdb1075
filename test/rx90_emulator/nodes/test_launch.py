"""The launch files, that of ros2_control too; launch itself stands in as a stub, its hardware as the source has it."""

import math
import re
import shutil
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
import xacro
import yaml
from launch_stub import Action, Context, arguments, build, ending
from processes import TIMEOUT, Processes
from ros_client import JOINTS, Client
from topic_hardware import TopicHardware

from rx90_common.base.share import config_path
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import DEFAULT_ROBOT, MODEL_FILES, RobotFiles
from rx90_common.process import interrupts

FILE, MOVEIT = "rx90.launch.py", "moveit.launch.py"


def nodes(actions: list[Action]) -> dict[str, Action]:
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
        assert answer.kind == "Shutdown"
    assert left == ([left_with] if code else [])


XACRO, LAUNCH = config_path("ros2_control/rx90.ros2_control.xacro"), "ros2_control.launch.py"
CONTROLLERS = yaml.safe_load(config_path("ros2_control/controllers.yaml").read_text(encoding="utf-8"))
PERIOD = 1.0 / CONTROLLERS["controller_manager"]["ros__parameters"]["update_rate"]
BANDWIDTH = 2.0 * math.pi * 5.0  # rad/s, for a loop that is closed at 250 Hz over topics


def description(mode: str, **more: str) -> ET.Element:
    return ET.fromstring(xacro.process_file(str(XACRO), mappings={"mode": mode, **more}).toxml())


@pytest.mark.parametrize(
    ("mode", "commands", "states"),
    [
        ("position", "/cell/rx90_controller/joint_setpoints", "/cell/joint_states"),
        ("effort", "/cell/joint_commands", "/cell/measured_joint_states"),
    ],
)
def test_the_description_names_joints_interfaces_and_topics(mode: str, commands: str, states: str) -> None:
    """The arm is in it whole; joints are the robot's, in its order, each commanded by the one interface of the mode."""
    files = RobotFiles()
    made = description(mode, namespace="/cell", urdf=str(files.urdf))
    arm = load_robot(files.urdf)
    links = [link.get("name") for link in ET.parse(files.urdf).getroot().findall("link")]
    assert [link.get("name") for link in made.findall("link")] == links
    system = made.find("ros2_control")
    given = {one.get("name"): one.text for one in system.findall("hardware/param")}
    assert given == {
        "joint_commands_topic": commands,
        "joint_states_topic": states,
        "trigger_joint_command_threshold": "-1",
    }
    joints = system.findall("joint")
    assert tuple(joint.get("name") for joint in joints) == arm.joint_names
    assert {tuple(one.get("name") for one in joint.findall("command_interface")) for joint in joints} == {(mode,)}
    name = {"position": "joint_trajectory_controller", "effort": "effort_controller"}[mode]
    controller = CONTROLLERS[name]["ros__parameters"]
    assert controller["joints"] == list(arm.joint_names)
    assert controller.get("command_interfaces", [controller.get("interface_name")]) == [mode]
    assert name in CONTROLLERS["controller_manager"]["ros__parameters"]


@pytest.mark.parametrize("mode", ["position", "effort"])
def test_what_the_launch_file_starts(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller manager hears the arm with tool and hardware; CS7B or torques at its rate, as the mode says."""
    (opaque,) = (action for action in build(monkeypatch, LAUNCH) if action.kind == "OpaqueFunction")
    publisher, manager, spawner, arm = opaque.named["function"](
        Context({"mode": mode, "robot": "rx90b", "controllers": ""})
    )
    (given,) = publisher.named["parameters"]
    described = ET.fromstring(given["robot_description"].given[0])
    assert {link.get("name") for link in described.findall("link")} >= {"base_link", "tool0", "tool"}
    assert [one.get("name") for one in described.findall("ros2_control/joint")] == JOINTS
    assert publisher.named["remappings"] == manager.named["remappings"]
    (file,) = manager.named["parameters"]
    assert spawner.named["arguments"][1:] == ["--param-file", file]
    assert yaml.safe_load(Path(file).read_text(encoding="utf-8"))[spawner.named["arguments"][0]]
    if mode == "position":
        assert dict(arm.named["launch_arguments"])["time_mode"] == "free_running"
    else:
        (parameters,) = arm.named["parameters"]
        assert parameters["command_interface"] == "joint"
        assert parameters["command_rate"] == round(1.0 / PERIOD)
    with pytest.raises(RuntimeError, match="mode:=dance; accepted: position, effort"):
        opaque.named["function"](Context({"mode": "dance", "robot": "rx90b", "controllers": ""}))


def manage(client: Client, hardware: TopicHardware, until: Callable[[], bool], update: Callable[[], None]) -> None:
    """Read, update and write at the controller manager's rate until something is reached."""
    deadline, due = time.monotonic() + TIMEOUT, time.monotonic()
    while not until():
        assert time.monotonic() < deadline, hardware.state
        due = max(due + PERIOD, time.monotonic())
        while (left := due - time.monotonic()) > 0.0:
            client.asking.spin(left)
        client.asking.spin(0.0)
        hardware.read()
        update()
        hardware.write()


def test_efforts_of_the_hardware_drive_the_arm(processes: Processes, client: Client) -> None:
    """Stamped by its own clock, at 250 Hz; NaN before a controller writes keeps the brakes closed and is one line."""
    words = ("time_mode:=free_running", "-p", "command_interface:=joint", "-p", "command_rate:=250")
    simulation = processes.start("rx90_sim", "--ros-args", "-p", *words)
    hardware = TopicHardware(client.node, ET.tostring(description("effort"), encoding="unicode"))
    first = ("joint_1", "position")
    manage(client, hardware, lambda: hardware.published > 100 and math.isfinite(hardware.state[first]), lambda: None)
    assert abs(hardware.state["joint_2", "position"]) < 1e-3  # held by its brake
    goal = hardware.state[first] + 0.05
    hold = {name: hardware.state[name, "position"] for name in JOINTS} | {"joint_1": goal}

    def follow() -> None:
        for name, inertia in zip(JOINTS, (12.0, 15.0, 3.5, 0.35, 0.29, 0.04), strict=True):  # joint side, kg m^2
            error = hold[name] - hardware.state[name, "position"]
            torque = BANDWIDTH * error - 1.4 * hardware.state[name, "velocity"]
            hardware.command[name, "effort"] = inertia * BANDWIDTH * torque

    manage(client, hardware, lambda: abs(hardware.state[first] - goal) < 0.01, follow)
    for said in ("nan", "of another clock"):
        assert len([line for line in simulation.lines if said in line]) == 1, simulation.output
    simulation.wait_for("no command on /joint_commands for 0.1 s: torque off, brakes closed")


def test_positions_of_the_hardware_are_followed(processes: Processes, client: Client) -> None:
    """A slow ramp of positions, stamped by the hardware's own clock, moves the arm; NaN before moves nothing."""
    cell = processes.start("rx90_cell", "--ros-args", "-p", "rx90_sim:time_mode:=free_running")
    hardware = TopicHardware(client.node, ET.tostring(description("position"), encoding="unicode"))
    first = ("joint_1", "position")
    manage(client, hardware, lambda: hardware.published > 100 and math.isfinite(hardware.state[first]), lambda: None)
    start = {name: hardware.state[name, "position"] for name in JOINTS}

    def hold() -> None:
        for name in JOINTS:
            hardware.command[name, "position"] = start[name]

    # as controllers do before they move; what is sent before the topic is matched is heard by nobody
    manage(client, hardware, lambda: "stream begins" in cell.output, hold)
    goal = start["joint_1"] + 0.05

    def ramp() -> None:
        for name in JOINTS[1:]:
            hardware.command[name, "position"] = start[name]
        hardware.command[first] = min(goal, hardware.command[first] + 0.1 * PERIOD)  # a held-up sender makes no jump

    manage(client, hardware, lambda: abs(hardware.state[first] - goal) < 1e-3, ramp)
