"""The names, types and units of the topics in a bag of the suite."""

from __future__ import annotations

from rx90_common.exchange.topics import (
    COMMANDED_CURRENT,
    CORRECTION,
    DETAILS,
    MOTOR_CURRENT,
    PARAMETERS,
    REFERENCE_ACCELERATION,
    TRAJECTORY_ACCEPTED,
)

JOINT_STATE = "sensor_msgs/msg/JointState"
CLOCK = "rosgraph_msgs/msg/Clock"
STRING = "std_msgs/msg/String"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"


POINT_FIELDS = ("positions", "velocities", "accelerations", "effort")
"""The arrays of a JointTrajectoryPoint, in the order of the message."""
EFFORT_UNIT = "rx90_emulator effort unit of "
"""Prefix of the key in rosbag2's custom_data that states the unit of a topic's efforts."""
USUAL_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}
FIELDS = tuple(USUAL_UNITS)
"""The arrays of a JointState."""

SUITE_TOPICS = (
    "joint_states",
    "friction_states",
    "motor_states",
    "motor_commands",
    "rx90_controller/joint_trajectory",
    f"rx90_controller/{TRAJECTORY_ACCEPTED}",
    "rx90_controller/reference",
    "rx90_controller/tracking_error",
    f"rx90_controller/{CORRECTION}",
    *(f"rx90_controller/{name}" for name in DETAILS),
    f"rx90_controller/{PARAMETERS}",
    f"rx90_sim/{PARAMETERS}",
    "robot_description",
)

_QUANTITIES = {
    "friction_states": {
        "position": ("bristle deflection", "rad"),
        "velocity": ("input velocity", "rad/s"),
        "effort": ("friction torque", "Nm"),
    },
    "tracking_error": {"effort": ("commanded torque", "Nm")},
    # JointState has no field for these.
    REFERENCE_ACCELERATION: {"effort": ("acceleration", "rad/s^2")},
    COMMANDED_CURRENT: {"effort": ("current", "A")},
    MOTOR_CURRENT: {"effort": ("current", "A")},
}
"""The quantities in the fields of a topic's messages if they differ from the fields' names."""


def reports_changes(topic: str, msgtype: str) -> bool:
    """Return whether a topic's messages are changes of parameters, stamped with simulated time."""
    return msgtype == PARAMETER_EVENT and topic.rpartition("/")[2] == PARAMETERS


def quantities(topic: str, effort_unit: str = "") -> dict[str, tuple[str, str]]:
    """Return the quantity of each field of a topic's messages, and its unit; with a unit of the efforts, if given."""
    usual = _QUANTITIES.get(topic.rpartition("/")[2], {})
    known = {**usual, "effort": ("effort", effort_unit)} if effort_unit else usual
    return {field: known.get(field, (field, unit)) for field, unit in USUAL_UNITS.items()}


def absolute(topic: str) -> str:
    """Return the topic's name as bags hold it, with the leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"
