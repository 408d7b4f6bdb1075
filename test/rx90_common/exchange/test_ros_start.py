"""What `prepare` sets and leaves alone; control_msgs: what is said where it is missing, and its types over DDS."""

import ctypes
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.exchange.ros_start import missing_messages, prepare

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
NAMES = (PROFILES, RANGE, "FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION", "ROS_STATIC_PEERS")


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.setenv(name, "")  # so that monkeypatch remembers each of them
        monkeypatch.delenv(name)


def now() -> dict[str, str]:
    return {name: os.environ[name] for name in NAMES if name in os.environ}


def test_on_a_network_udp_and_the_shipped_profiles_are_chosen() -> None:
    """Without a discovery range the range stays ROS's own, on UDP, with a profile file that exists."""
    prepare()
    assert set(now()) == {PROFILES, "FASTDDS_BUILTIN_TRANSPORTS"}
    assert Path(now()[PROFILES]).name == "profiles.xml"
    assert Path(now()[PROFILES]).is_file()


def test_localhost_is_a_profile_of_its_own() -> None:
    """LOCALHOST, with which ROS would add shared memory, becomes a profile on 127.0.0.1, but not with static peers."""
    os.environ[RANGE] = "localhost"
    prepare()
    assert now()[RANGE] == "SYSTEM_DEFAULT"
    assert Path(now()[PROFILES]).name == "localhost.xml"
    first = now()
    prepare()  # as a child process does
    assert now() == first
    del os.environ[PROFILES]
    own = {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"}  # which reach further
    os.environ.update(own)
    prepare()
    assert {name: now()[name] for name in own} == own


@pytest.mark.parametrize(
    "own",
    [
        {PROFILES: "/my/profiles.xml", RANGE: "LOCALHOST"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"},
    ],
)
def test_what_the_user_has_set_stays(own: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Profiles of the user's own and another middleware are left as they are."""
    monkeypatch.setattr(ctypes, "CDLL", lambda _name: None)  # any middleware is installed
    os.environ.update(own)
    prepare()
    assert now() == own


def test_both_profiles_have_the_same_writers() -> None:
    """The two files differ in the transport, never in how the topics of the ticks are repaired and kept."""
    names = []
    for range_name in ("LOCALHOST", "SUBNET"):
        os.environ.pop(PROFILES, None)
        os.environ[RANGE] = range_name
        prepare()
        tree = ET.parse(now()[PROFILES])
        for element in tree.iter():
            element.tail = element.text = (element.text or "").strip() or None
        space = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
        names.append([ET.tostring(writer) for writer in tree.iter(f"{space}data_writer")])
    assert names[0] == names[1]
    assert len(names[0]) == 3


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [("ROS_DOMAIN_ID", "233", "0 to 232"), ("RMW_IMPLEMENTATION", "rmw_nothing_cpp", "rmw_fastrtps_cpp")],
)
def test_what_cannot_be_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str, accepted: str) -> None:
    """A domain without ports and a middleware that is not installed are named with what is accepted."""
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=f"{name} is '{value}'.*{accepted}"):
        prepare()


@pytest.mark.parametrize(
    ("distribution", "accepted"),
    [("", "make action, in the project's folder"), ("jazzy", "sudo apt install ros-jazzy-control-msgs")],
)
def test_missing_types_are_one_line(distribution: str, accepted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without control_msgs the line names it and the command: the project's own, or apt's where ROS is sourced."""
    monkeypatch.setattr(sys, "path", [])
    for name in [name for name in sys.modules if name.partition(".")[0] == "control_msgs"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setenv("ROS_DISTRO", distribution)
    assert missing_messages("control_msgs") == f"needs control_msgs, which is not installed; accepted: {accepted}"


STUCK = """
import time
from rx90_common.exchange import lifecycle
from rx90_common.exchange.ros_start import prepare
prepare()
lifecycle._SHUTDOWN_S = 0.5
class Stuck:
    def __init__(self):
        import rclpy
        self.node = rclpy.create_node("stuck")
    def tick_loop(self):
        pass
    def stop(self):
        time.sleep(600)
lifecycle.spin(lambda: [Stuck()], [])
"""


@pytest.mark.ros
@pytest.mark.usefixtures("ros_domain", "warm")
def test_a_node_that_does_not_end_is_cut_off() -> None:
    """Where shutdown hangs, the process ends with a line and exit code 3."""
    done = subprocess.run([sys.executable, "-c", STUCK], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (3, "not ended after 0.5 s: cut off")
