"""What both nodes share, on real DDS in one process."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import Client
from sensor_msgs.msg import JointState

from rx90_common.exchange import node_tools


@pytest.mark.ros
@pytest.mark.usefixtures("ros_domain")
def test_a_robot_folder_s_missing_file_is_named_once(tmp_path: Path) -> None:
    """The files that a node takes from a robot folder are those of the folder, whether they are there or not."""
    (tmp_path / "drives.yaml").touch()
    client = Client()
    try:
        client.node._parameter_overrides["robot"] = Parameter("robot", value=str(tmp_path))
        files = node_tools.declare_robot_files(client.node, "urdf", "drives", "tool")
        assert (files.urdf, files.drives, files.tool) == (tmp_path / "robot.urdf", tmp_path / "drives.yaml", None)
    finally:
        client.close()


@pytest.mark.ros
@pytest.mark.usefixtures("ros_domain")
def test_a_subscriber_that_never_fits_is_not_waited_for() -> None:
    """A subscriber that asks for more than is offered does not keep the others waiting."""
    client = Client()
    try:
        heard = client.listen("joint_states")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        client.node.create_subscription(JointState, "joint_states", heard.append, latched)
        publisher = client.node.create_publisher(JointState, "joint_states", 10)
        client.spin_until(lambda: client.node.count_subscribers("joint_states") == 2, "both in the graph")
        assert node_tools.wait_until_matched(client.node, [publisher], 200)
        assert publisher.get_subscription_count() == 1
    finally:
        client.close()
