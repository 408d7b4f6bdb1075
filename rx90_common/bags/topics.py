"""The names, types and units of what a bag of the suite holds."""

from __future__ import annotations

from typing import Final

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
CLOCK: Final = "rosgraph_msgs/msg/Clock"
STRING: Final = "std_msgs/msg/String"

FIELDS: Final = ("position", "velocity", "effort")
UNITS: Final = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}

SUITE_TOPICS: Final = (
    "joint_states",
    "friction_states",
    "motor_states",
    "motor_commands",
    "rx90_controller/joint_trajectory",
    "rx90_controller/reference",
    "rx90_controller/tracking_error",
    "robot_description",
)

_QUANTITIES: Final = {"friction_states": ("bristle deflection", "input velocity", "friction torque")}
"""What the fields of a topic's messages hold where it is not what they are called."""


def quantities(topic: str) -> dict[str, str]:
    """Return what each field of a topic's messages holds, with its unit, such as `position [rad]`."""
    names = _QUANTITIES.get(topic.rpartition("/")[2], FIELDS)
    return {field: f"{name} [{UNITS[field]}]" for field, name in zip(FIELDS, names, strict=True)}


def absolute(topic: str) -> str:
    """Return the topic's name as bags hold it, with the leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"
