"""The arm as hardware of ros2_control by topics: its description, its launch file, and the exchange with the hardware.

The hardware is `topic_hardware.TopicHardware`, which does what the source of JointStateTopicSystem does.
"""

from __future__ import annotations

import math
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
import xacro
import yaml
from launch_stub import Context, build
from processes import TIMEOUT, Processes
from ros_client import JOINTS, Client
from topic_hardware import TopicHardware

from rx90_common.base.share import config_path
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles

FILE, LAUNCH = config_path("ros2_control/rx90.ros2_control.xacro"), "ros2_control.launch.py"
CONTROLLERS = yaml.safe_load(config_path("ros2_control/controllers.yaml").read_text(encoding="utf-8"))
PERIOD = 1.0 / CONTROLLERS["controller_manager"]["ros__parameters"]["update_rate"]
INERTIA = (12.0, 15.0, 3.5, 0.35, 0.29, 0.04)  # joint side, kg m^2
BANDWIDTH = 2.0 * math.pi * 5.0  # rad/s, for a loop that is closed at 250 Hz over topics


def description(mode: str, **more: str) -> ET.Element:
    """Return what xacro makes of the file."""
    return ET.fromstring(xacro.process_file(str(FILE), mappings={"mode": mode, **more}).toxml())


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
    assert system is not None
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
    simulation = processes.start(
        "rx90_sim", "--ros-args", "-p", "time_mode:=free_running", "-p", "command_interface:=joint",
        "-p", "command_rate:=250",
    )  # fmt: skip
    hardware = TopicHardware(client.node, ET.tostring(description("effort"), encoding="unicode"))
    first = ("joint_1", "position")
    manage(client, hardware, lambda: hardware.published > 100 and math.isfinite(hardware.state[first]), lambda: None)
    assert abs(hardware.state["joint_2", "position"]) < 1e-3  # held by its brake
    goal = hardware.state[first] + 0.05
    hold = {name: hardware.state[name, "position"] for name in JOINTS} | {"joint_1": goal}

    def follow() -> None:
        for name, inertia in zip(JOINTS, INERTIA, strict=True):
            error = hold[name] - hardware.state[name, "position"]
            damping = 1.4 * BANDWIDTH * hardware.state[name, "velocity"]
            hardware.command[name, "effort"] = inertia * (BANDWIDTH**2 * error - damping)

    manage(client, hardware, lambda: abs(hardware.state[first] - goal) < 0.01, follow)
    for words in ("nan", "of another clock"):
        assert len([line for line in simulation.lines if words in line]) == 1, simulation.output
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
