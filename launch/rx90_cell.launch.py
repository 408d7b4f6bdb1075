"""Start simulation and controller in one process: rx90.launch.py, with its arguments, and composed:=true."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource


def generate_launch_description() -> LaunchDescription:
    file = Path(__file__).with_name("rx90.launch.py")
    included = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(file)), launch_arguments={"composed": "true"}.items()
    )
    return LaunchDescription([included])
