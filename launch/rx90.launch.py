"""Start the simulation and the controller and, when asked, robot_state_publisher and RViz.

When one of the nodes ends, the others are ended too, and the launch ends with its exit code.
"""

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, OrSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import DESCRIPTIONS, SHIPPED, RobotFiles
from rx90_common.process.exit_code import end_with

PACKAGE = "rx90_emulator"
ARGUMENTS = (
    ("namespace", "", "of all nodes; then /clock, /tf and /tf_static are in it too"),
    ("time_mode", "lock_step", "lock_step or free_running"),
    ("real_time_factor", "1.0", "pace in lock_step; 0.0: as fast as it goes"),
    ("initial_position", "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "joint positions at the start and after a reset, rad"),
    ("paused", "false", "begin with time standing still"),
    *((name, file, f"{DESCRIPTIONS[name]}; shipped or your own") for name, file in SHIPPED.items()),
    ("robot_state_publisher", "false", "publish the transforms of the arm"),
    ("rviz", "false", "show the arm in RViz, with its transforms"),
)
TYPES = {"real_time_factor": float, "paused": bool}
# Two robots must not share a clock or their transforms. Without a namespace these are the names that they have anyway.
OWN = [(f"/{topic}", topic) for topic in ("clock", "tf", "tf_static")]


def given(*names: str) -> dict[str, ParameterValue]:
    """Return the parameters that have the names of arguments."""
    return {name: ParameterValue(LaunchConfiguration(name), value_type=TYPES.get(name, str)) for name in names}


def end(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    """End the launch as the node has ended, unless it was ended by the launch."""
    if context.is_shutdown:
        return None
    end_with(event.returncode)
    return Shutdown(reason=f"{event.process_name} has ended with exit code {event.returncode}")


def node(executable: str, *parameters: str, numbers: str = "") -> Node:
    """Return one of the suite's nodes; its parameter `numbers` is a list."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[given(*parameters)],
        # Read by the node: launch takes no list of whole numbers for one of real ones.
        ros_arguments=["-p", [f"{numbers}:=", LaunchConfiguration(numbers)]] if numbers else None,
        remappings=OWN,
        output="screen",
        on_exit=end,
    )


def transforms(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return robot_state_publisher with the robot that the simulation has."""
    # Here, because it takes a while and most launches do without.
    from rx90_common.description.robot import load_robot

    files = RobotFiles.named(**{name: LaunchConfiguration(name).perform(context) for name in ("urdf", "tool")})
    robot = load_robot(files.urdf, files.tool)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=LaunchConfiguration("namespace"),
            parameters=[{"robot_description": ParameterValue(robot.urdf, value_type=str), "use_sim_time": True}],
            # The simulation publishes the description under that name.
            remappings=[*OWN, ("robot_description", "robot_state_publisher/robot_description")],
            on_exit=end,
        )
    ]


def generate_launch_description() -> LaunchDescription:
    wanted = OrSubstitution(LaunchConfiguration("robot_state_publisher"), LaunchConfiguration("rviz"))
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=["-d", str(config_path("rviz/rx90.rviz"))],
        parameters=[{"use_sim_time": True}],
        remappings=OWN,
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, value, text in ARGUMENTS]
    # A missing package ends the launch: what may be missing comes first, so that no node is left behind then.
    return LaunchDescription(
        [
            *declared,
            OpaqueFunction(function=transforms, condition=IfCondition(wanted)),
            rviz,
            node(
                "rx90_sim",
                *("time_mode", "real_time_factor", "paused", "urdf", "tool", "drives", "friction"),
                numbers="initial_position",
            ),
            node("rx90_controller", "urdf", "drives", "controller"),
        ]
    )
