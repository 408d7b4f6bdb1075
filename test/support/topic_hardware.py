"""A stand-in for JointStateTopicSystem of ros-controls/topic_based_hardware_interfaces (1.1.0), in Python.

It does what joint_state_topic_hardware_interface.cpp does: the same topics, quality of service, stamps, order of names
and condition for publishing. The controller manager calls `read`, lets controllers write `command`, and calls `write`,
at its update rate. Until a controller has written a command it is NaN, as a fresh handle of hardware_interface is; NaN
compared with the threshold is no reason not to publish, there as here.
"""

import math
import xml.etree.ElementTree as ET
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState

_FIELDS = ("position", "velocity", "effort")
_USUAL_THRESHOLD = 1e-5


class TopicHardware:
    """The hardware component of a URDF; state and command are by joint and interface, NaN until one has come."""

    def __init__(self, node: Node, urdf: str) -> None:
        system = ET.fromstring(urdf).find("ros2_control")
        hardware = system.find("hardware")
        assert hardware.findtext("plugin") == "joint_state_topic_hardware_interface/JointStateTopicSystem"
        given = {str(one.get("name")): str(one.text) for one in hardware.findall("param")}
        self._threshold = float(given.get("trigger_joint_command_threshold", _USUAL_THRESHOLD))
        joints = system.findall("joint")
        self.joints = [str(joint.get("name")) for joint in joints]
        self.interfaces = [[str(one.get("name")) for one in joint.findall("command_interface")] for joint in joints]
        self.state = {(str(joint.get("name")), str(one.get("name"))): math.nan
                      for joint in joints for one in joint.findall("state_interface")}  # fmt: skip
        self.command = {(name, one): math.nan for name, found in zip(self.joints, self.interfaces, strict=True)
                        for one in found}  # fmt: skip
        self._node, self._latest, self.published = node, JointState(), 0
        topic = given.get("joint_commands_topic", "/robot_joint_commands")
        self._publisher = node.create_publisher(JointState, topic, QoSProfile(depth=1))
        topic = given.get("joint_states_topic", "/robot_joint_states")
        node.create_subscription(JointState, topic, self._take, qos_profile_sensor_data)

    def _take(self, message: JointState) -> None:
        self._latest = message

    def read(self) -> None:
        for i, name in enumerate(self._latest.name):
            for field in _FIELDS:
                values: Any = getattr(self._latest, field)
                if (name, field) in self.state and len(values) and math.isfinite(values[i]):
                    self.state[name, field] = values[i]

    def write(self) -> None:
        """Publish the commands unless they are, summed over all joints, as near to the states as the threshold."""
        diff = sum(abs(self.state.get(key, math.nan) - value) for key, value in self.command.items())
        if diff <= self._threshold:
            return
        message = JointState()
        for name, found in zip(self.joints, self.interfaces, strict=True):
            message.name.append(name)
            message.header.stamp = self._node.get_clock().now().to_msg()
            for one in found:
                getattr(message, one).append(self.command[name, one])
        self._publisher.publish(message)
        self.published += 1
