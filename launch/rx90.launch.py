"""Start simulation and controller, in a process each or in one, and, when asked, robot_state_publisher and RViz.

When one of the nodes ends, the others are ended too, and the launch ends with its exit code.
"""

from pathlib import Path

from launch import Action, Condition, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition, UnlessCondition
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, OrSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import DEFAULT_ROBOT, DESCRIPTIONS, MODEL_FILES, RobotFiles
from rx90_common.process.interrupts import end_with

PARAMETERS = Path(__file__).with_name("rx90_parameters.yaml")
ARGUMENTS = (
    ("namespace", "", "of all nodes; then /clock, /tf and /tf_static are in it too"),
    ("time_mode", "lock_step", "lock_step or free_running"),
    ("real_time_factor", "1.0", "pace in lock_step; 0.0: as fast as it goes"),
    (
        "initial_position",
        "[0.0]",
        "joint positions at the start and after a reset, rad; one for each, or one for all",
    ),
    ("paused", "false", "begin with time standing still"),
    ("autostart", "true", "be active at once; else as the nodes' lifecycle services say"),
    ("robot", DEFAULT_ROBOT, "name of a shipped robot, or your own robot folder"),
    *((name, "", f"{DESCRIPTIONS[name]}; left out: the robot's") for name in MODEL_FILES),
    (
        "velocities_from_positions",
        "false",
        "leave aside the velocities that points carry between both ends",
    ),
    ("composed", "false", "both nodes in one process, which is several times faster"),
    ("robot_state_publisher", "false", "publish the transforms of the arm"),
    ("rviz", "false", "show the arm in RViz, with its transforms"),
)
# Two robots must not share a clock or their transforms. Without a namespace these are the names that they have anyway.
OWN = [(f"/{topic}", topic) for topic in ("clock", "tf", "tf_static")]


def end(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    """End the launch as the node has ended, unless it was ended by the launch."""
    if context.is_shutdown:
        return None
    end_with(event.returncode)
    return Shutdown(reason=f"{event.process_name} has ended with exit code {event.returncode}")


def node(executable: str, condition: Condition) -> Node:
    """Return one of the suite's executables."""
    return Node(
        package="rx90_emulator",
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[ParameterFile(str(PARAMETERS), allow_substs=True)],
        remappings=OWN,
        output="screen",
        on_exit=end,
        condition=condition,
    )


def transforms(context: LaunchContext) -> list[Action]:
    """Return robot_state_publisher with the robot that the simulation has."""
    # Here, because it takes a while and most launches do without.
    from rx90_common.description.robot import load_robot

    robot, urdf, tool = (
        LaunchConfiguration(name).perform(context) or None for name in ("robot", "urdf", "tool")
    )
    files = RobotFiles.named(robot, urdf=urdf, tool=tool)
    robot = load_robot(files.urdf, files.tool)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=LaunchConfiguration("namespace"),
            parameters=[
                {
                    "robot_description": ParameterValue(robot.urdf, value_type=str),
                    "use_sim_time": True,
                }
            ],
            # The simulation publishes the description under that name.
            remappings=[*OWN, ("robot_description", "robot_state_publisher/robot_description")],
            on_exit=end,
        )
    ]


def generate_launch_description() -> LaunchDescription:
    wanted = OrSubstitution(
        LaunchConfiguration("robot_state_publisher"), LaunchConfiguration("rviz")
    )
    composed = LaunchConfiguration("composed")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", str(config_path("rviz/rx90.rviz"))],
        parameters=[{"use_sim_time": True}],
        remappings=OWN,
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    # A missing package ends the launch: what may be missing comes first, so that no node is left behind then.
    return LaunchDescription(
        [
            *declared,
            OpaqueFunction(function=transforms, condition=IfCondition(wanted)),
            rviz,
            node("rx90_sim", UnlessCondition(composed)),
            node("rx90_controller", UnlessCondition(composed)),
            node("rx90_cell", IfCondition(composed)),
        ]
    )
