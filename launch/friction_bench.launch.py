"""The friction rig's node, on an emulated rig by default: port:=/dev/ttyUSB0 for a real one."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from rx90_common.base.share import SHIPPED_RIG


def generate_launch_description():
    arguments = {"port": "emulated", "rig": SHIPPED_RIG}
    return LaunchDescription(
        [DeclareLaunchArgument(name, default_value=value) for name, value in arguments.items()]
        + [
            Node(
                package="rx90_emulator",
                executable="friction_bench",
                parameters=[{name: LaunchConfiguration(name) for name in arguments}],
                output="screen",
            )
        ]
    )
