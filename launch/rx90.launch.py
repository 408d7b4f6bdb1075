"""Start simulation and controller, in a process each or in one, and, when asked, robot_state_publisher and RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, OrSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import DESCRIPTIONS, SHIPPED

PACKAGE = "rx90_emulator"
FILES = ("tool", "drives", "friction", "controller")
OF_SIMULATION = ("time_mode", "tool", "drives", "friction")
OF_CONTROLLER = ("drives", "controller")
ARGUMENTS = (
    ("time_mode", "lock_step", "lock_step or free_running"),
    ("real_time_factor", "1.0", "pace in lock_step; 0.0: as fast as it goes"),
    *((name, SHIPPED[name], f"{DESCRIPTIONS[name]}; shipped or your own") for name in FILES),
    ("composed", "false", "both nodes in one process, which is several times faster"),
    ("robot_state_publisher", "false", "publish the transforms of the arm"),
    ("rviz", "false", "show the arm in RViz, with its transforms"),
)


def generate_launch_description() -> LaunchDescription:
    urdf = config_path(SHIPPED["urdf"]).read_text(encoding="utf-8")

    def given(*names: str) -> dict[str, ParameterValue]:
        return {name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in names}

    factor = ParameterValue(LaunchConfiguration("real_time_factor"), value_type=float)
    apart = UnlessCondition(LaunchConfiguration("composed"))
    simulation = Node(
        package=PACKAGE,
        executable="rx90_sim",
        output="screen",
        parameters=[given(*OF_SIMULATION) | {"real_time_factor": factor}],
        condition=apart,
    )
    controller = Node(
        package=PACKAGE,
        executable="rx90_controller",
        output="screen",
        parameters=[given(*OF_CONTROLLER)],
        condition=apart,
    )
    # Parameters of a launch file's node would go to both nodes of the process.
    of_both = [("rx90_sim", name) for name in (*OF_SIMULATION, "real_time_factor")]
    of_both += [("rx90_controller", name) for name in OF_CONTROLLER]
    cell = Node(
        package=PACKAGE,
        executable="rx90_cell",
        output="screen",
        ros_arguments=[
            word for node, name in of_both for word in ("-p", [f"{node}:{name}:=", LaunchConfiguration(name)])
        ],
        condition=IfCondition(LaunchConfiguration("composed")),
    )
    wanted = OrSubstitution(LaunchConfiguration("robot_state_publisher"), LaunchConfiguration("rviz"))
    transforms = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        parameters=[{"robot_description": ParameterValue(urdf, value_type=str), "use_sim_time": True}],
        # The simulation publishes the description, with its tool, under that name.
        remappings=[("robot_description", "robot_state_publisher/robot_description")],
        condition=IfCondition(wanted),
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(config_path("rviz/rx90.rviz"))],
        parameters=[{"use_sim_time": True}],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, value, text in ARGUMENTS]
    # A missing package ends the launch: what may be missing comes first, so that no node is left behind then.
    return LaunchDescription([*declared, transforms, rviz, simulation, controller, cell])
