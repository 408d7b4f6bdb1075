"""The definitions in interfaces/: the types are those of ROS 2 Jazzy; and how they are built."""

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore

from tools import interfaces

# Of the definitions in ros-controls/control_msgs, branch jazzy, at f901df2 (5.8.0): hashed by Jazzy's
# rosidl_generator_type_description 4.6.6; those of the messages by rosbags 0.11.9 too.
JAZZY = {
    "action/FollowJointTrajectory": "738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6",
    "action/FollowJointTrajectory_Goal": "8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205",
    "action/FollowJointTrajectory_SendGoal": "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    "action/FollowJointTrajectory_GetResult": "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    "action/FollowJointTrajectory_FeedbackMessage": "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    "msg/JointComponentTolerance": "739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4",
    "msg/JointTolerance": "c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648",
    "msg/JointTrajectoryControllerState": "51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    "msg/SpeedScalingFactor": "0c240f349f2b74e33e8741f83e0f196ddeb6585923663876ed3c1f51f0566037",
    "srv/QueryTrajectoryState": "4a0935dffef18bc5b9e101c9d03d84e681ecd4cebd724b8f11fde008751a325a",
}


def hash_in(library: Path, package: str, name: str) -> bytes:
    function = getattr(ctypes.PyDLL(str(library)), f"{package}__{name.replace('/', '__')}__get_type_hash")
    function.restype = ctypes.c_void_p
    return ctypes.string_at(function(None), 33)


@pytest.fixture(scope="module")
def library(needs_action: None) -> Path:  # noqa: ARG001 - it must be there
    import control_msgs

    return Path(control_msgs.__file__).with_name("libcontrol_msgs__rosidl_generator_c.so")


@pytest.mark.usefixtures("needs_tf")
def test_the_types_are_those_of_jazzy(library: Path) -> None:
    """The built packages have the type hashes (REP 2016) of Jazzy's: same fields, types and order."""
    import tf2_msgs

    found = {name: hash_in(library, "control_msgs", name) for name in JAZZY}
    assert found == {name: b"\x01" + bytes.fromhex(expected) for name, expected in JAZZY.items()}
    transforms = Path(tf2_msgs.__file__).with_name("libtf2_msgs__rosidl_generator_c.so")
    expected = get_typestore(Stores.ROS2_JAZZY).hash_rihs01("tf2_msgs/msg/TFMessage").removeprefix("RIHS01_")
    assert hash_in(transforms, "tf2_msgs", "msg/TFMessage") == b"\x01" + bytes.fromhex(expected)


@pytest.mark.usefixtures("needs_action", "needs_tf")
def test_the_command_line_of_ros_finds_the_definitions(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the ament index each package names the definitions that lie in its share folder: `ros2 interface show`."""
    from ament_index_python.packages import get_package_share_directory
    from ament_index_python.resources import get_resource

    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    for package in interfaces.PACKAGES:
        names = get_resource("rosidl_interfaces", package)[0].split("\n")
        share = Path(get_package_share_directory(package))
        own = {f"{path.parent.name}/{path.name}": path.read_bytes() for path in interfaces.definitions(package)}
        assert {name: (share / name).read_bytes() for name in names} == own


@pytest.mark.usefixtures("needs_action")
def test_the_constants_are_those_of_jazzy() -> None:
    """Result codes and components, which no type hash covers, have Jazzy's values."""
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointComponentTolerance

    codes = ("SUCCESSFUL", "INVALID_GOAL", "INVALID_JOINTS", "OLD_HEADER_TIMESTAMP")
    codes += ("PATH_TOLERANCE_VIOLATED", "GOAL_TOLERANCE_VIOLATED")
    assert [getattr(FollowJointTrajectory.Result, name) for name in codes] == [0, -1, -2, -3, -4, -5]
    components = ("X_AXIS", "Y_AXIS", "Z_AXIS", "TRANSLATION", "ROTATION")
    assert [getattr(JointComponentTolerance, name) for name in components] == [1, 2, 3, 4, 5]


def test_the_library_finds_what_it_is_linked_with(library: Path) -> None:
    """The module is loaded where LD_LIBRARY_PATH is not set, and with it every library of the package."""
    bare = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # or the wheels would set it
    module = library.with_name("control_msgs_s__rosidl_typesupport_c.so")
    code = (
        "import ctypes, os, sys; assert 'LD_LIBRARY_PATH' not in os.environ; ctypes.PyDLL(sys.argv[1]); "
        "[ctypes.CDLL(name) for name in sys.argv[2:]]"
    )
    names = sorted(path.name for path in library.parent.glob("lib*.so"))
    assert len(names) == 3
    done = subprocess.run(
        [sys.executable, "-c", code, module, *names], env=bare, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
