"""Start the arm, its controller and MoveIt: rx90.launch.py with robot_state_publisher, move_group and RViz.

Takes the arguments of rx90.launch.py, but for `urdf` and `tool`: MoveIt's files are made for the arm and the tool of a
robot folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles

if TYPE_CHECKING:
    from rx90_common.description.robot import RobotModel

ARGUMENTS = (
    ("namespace", "", "of all nodes; then /clock, /tf and /tf_static are in it too"),
    (
        "robot",
        DEFAULT_ROBOT,
        "name of a shipped robot, or your own robot folder with a folder moveit/ in it",
    ),
    ("rviz", "true", "plan and execute in RViz"),
)
PIPELINES = ["pilz_industrial_motion_planner", "ompl"]
# Two robots must not share a clock or their transforms. Without a namespace these are the names that they have anyway.
OWN = [(f"/{topic}", topic) for topic in ("clock", "tf", "tf_static")]


def settings(name: str) -> dict[str, Any]:
    """Return a file of config/moveit/."""
    return dict(yaml.safe_load(config_path(f"moveit/{name}.yaml").read_text(encoding="utf-8")))


def of_robot(files: RobotFiles, name: str) -> str:
    """Return the text of a file in the folder moveit/ of a robot folder."""
    file = files.urdf.parent / "moveit" / name
    if not file.is_file():
        folder = files.urdf.parent
        raise RuntimeError(
            f"{file} is missing; accepted: a robot folder for which `python -m tools.moveit_files {folder}` made it"
        )
    return file.read_text(encoding="utf-8")


def description(robot: RobotModel, files: RobotFiles) -> dict[str, Any]:
    """Return the parameters that say what the robot is, for move_group and RViz."""
    limits = yaml.safe_load(of_robot(files, "joint_limits.yaml"))
    return {
        "robot_description": ParameterValue(robot.urdf, value_type=str),
        "robot_description_semantic": ParameterValue(of_robot(files, "robot.srdf"), value_type=str),
        "robot_description_kinematics": settings("kinematics"),
        "robot_description_planning": {**limits, **settings("pilz_cartesian_limits")},
        "planning_pipelines": PIPELINES,
        "default_planning_pipeline": PIPELINES[0],
        **{pipeline: settings(f"{pipeline}_planning") for pipeline in PIPELINES},
        # The states are stamped with simulated time.
        "use_sim_time": True,
    }


def execution(robot: RobotModel) -> dict[str, Any]:
    """Return the parameters that say how trajectories are executed, for move_group."""
    found = settings("moveit_controllers")
    controllers = found["moveit_simple_controller_manager"]
    for name in controllers["controller_names"]:
        controllers[name]["joints"] = list(robot.joint_names)
    return found


def moveit(context: LaunchContext) -> list[Action]:
    """Return move_group and RViz."""
    for name in ("urdf", "tool"):
        given = context.launch_configurations.get(name)
        if given:
            accepted = f"robot:=FOLDER with that {name}"
            raise RuntimeError(
                f"{name}:={given}: MoveIt's files are made for a robot folder; accepted: {accepted}"
            )
    # Here, because it takes a while.
    from rx90_common.description.robot import load_robot

    files = RobotFiles.named(LaunchConfiguration("robot").perform(context))
    robot = load_robot(files.urdf, files.tool)
    described = description(robot, files)
    where = {"namespace": LaunchConfiguration("namespace"), "remappings": OWN, "output": "screen"}
    # What is planned and what is executed is shown in RViz through these.
    shown = ("planning_scene", "geometry_updates", "state_updates", "transforms_updates")
    return [
        Node(
            package="moveit_ros_move_group",
            executable="move_group",
            parameters=[described, execution(robot), {f"publish_{what}": True for what in shown}],
            on_exit=Shutdown(reason="move_group has ended"),
            **where,
        ),
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(config_path("rviz/moveit.rviz"))],
            parameters=[described],
            condition=IfCondition(LaunchConfiguration("rviz")),
            **where,
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    arm = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(Path(__file__).with_name("rx90.launch.py"))),
        # The other RViz stays closed; what is set here holds for what comes after it, too.
        # Velocities of Pilz' lines do not belong to their positions (docs/howto/moveit.md).
        launch_arguments={
            "robot_state_publisher": "true",
            "rviz": "false",
            "velocities_from_positions": "true",
        }.items(),
    )
    # A missing package ends the launch: what may be missing comes first, so that no node is left behind then.
    return LaunchDescription([*declared, OpaqueFunction(function=moveit), arm])
