"""The friction rig's node, on an emulated rig by default: port:=/dev/ttyUSB0 for a real one.

When the node ends, the launch ends with its exit code.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from rx90_common.base.share import SHIPPED_RIG
from rx90_common.process.interrupts import end_with

ARGUMENTS = (
    ("namespace", "", "of the node"),
    ("port", "emulated", "serial device, pyserial URL, or emulated"),
    ("rig", SHIPPED_RIG, "rig file; shipped or your own"),
    ("seed", "0", "seed of the emulated rig's noise"),
)
TYPES = {"port": str, "rig": str, "seed": int}


def end(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    """End the launch as the node has ended, unless it was ended by the launch."""
    if context.is_shutdown:
        return None
    end_with(event.returncode)
    return Shutdown(reason=f"{event.process_name} has ended with exit code {event.returncode}")


def generate_launch_description() -> LaunchDescription:
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in TYPES.items()
    }
    node = Node(
        package="rx90_emulator",
        executable="friction_bench",
        namespace=LaunchConfiguration("namespace"),
        parameters=[given],
        output="screen",
        on_exit=end,
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    return LaunchDescription([*declared, node])
