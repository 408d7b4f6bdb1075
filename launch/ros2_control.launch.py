"""Start the arm as hardware of ros2_control: simulation, robot_state_publisher, controller manager, one controller.

Needs joint_state_topic_hardware_interface, controller_manager and ros2_controllers. In mode position the CS7B follows
streamed set-points of joint_trajectory_controller; in mode effort a forward controller commands torques at the joints,
and there is no CS7B. Time runs freely, because the hardware stamps its commands with a clock of its own.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import xacro
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles

ARGUMENTS = (
    ("mode", "position", "position: set-points for the CS7B; effort: torques at the joints"),
    ("robot", DEFAULT_ROBOT, "name of a shipped robot, or your own robot folder"),
    (
        "controllers",
        "",
        "parameters of controller manager and controllers; left out: config/ros2_control/",
    ),
)
CONTROLLERS = {"position": "joint_trajectory_controller", "effort": "effort_controller"}
# Torques are commanded as often as the controller manager of the shipped file updates.
EFFORTS = {"command_interface": "joint", "command_rate": 250, "time_mode": "free_running"}
DESCRIPTION = ("robot_description", "robot_state_publisher/robot_description")
"""The simulation publishes the arm without ros2_control under the usual name."""


def described(files: RobotFiles, mode: str) -> str:
    """Return the URDF of the arm and its tool, with the element ros2_control."""
    # Here, because it takes a while.
    from rx90_common.description.robot import load_robot

    arm = ET.fromstring(load_robot(files.urdf, files.tool).urdf)
    file = str(config_path("ros2_control/rx90.ros2_control.xacro"))
    arm.extend(
        ET.fromstring(xacro.process_file(file, mappings={"mode": mode}).toxml()).findall(
            "ros2_control"
        )
    )
    return ET.tostring(arm, encoding="unicode")


def actions(context: LaunchContext) -> list[Action]:
    """Return what is started."""
    mode, robot, given = (LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS)
    if mode not in CONTROLLERS:
        raise RuntimeError(f"mode:={mode}; accepted: {', '.join(CONTROLLERS)}")
    controllers = given or str(config_path("ros2_control/controllers.yaml"))
    description = ParameterValue(described(RobotFiles.named(robot), mode), value_type=str)
    started: list[Action] = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            parameters=[{"robot_description": description}],
            remappings=[DESCRIPTION],
        ),
        Node(
            package="controller_manager",
            executable="ros2_control_node",
            parameters=[controllers],
            remappings=[DESCRIPTION],
            output="screen",
            on_exit=Shutdown(reason="the controller manager has ended"),
        ),
        Node(
            package="controller_manager",
            executable="spawner",
            arguments=[CONTROLLERS[mode], "--param-file", controllers],
        ),
    ]
    if mode == "effort":
        parameters = [{"robot": robot, **EFFORTS}]
        arm: Action = Node(
            package="rx90_emulator", executable="rx90_sim", parameters=parameters, output="screen"
        )
    else:
        file = str(Path(__file__).with_name("rx90.launch.py"))
        words = {"robot": robot, "time_mode": "free_running"}
        arm = IncludeLaunchDescription(
            PythonLaunchDescriptionSource(file), launch_arguments=words.items()
        )
    # What may be missing comes first: a missing package ends the launch, and no node is left behind then.
    return [*started, arm]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=actions)])
