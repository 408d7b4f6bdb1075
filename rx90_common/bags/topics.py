"""The names, types and units of what a bag of the suite holds."""

from __future__ import annotations

from typing import Final

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
CLOCK: Final = "rosgraph_msgs/msg/Clock"
STRING: Final = "std_msgs/msg/String"
JOINT_TRAJECTORY: Final = "trajectory_msgs/msg/JointTrajectory"

TRAJECTORY_ACCEPTED: Final = "trajectory_accepted"
"""A controller's topic: what it follows, stamped with the time at which that starts."""

FIELDS: Final = ("position", "velocity", "effort")
_USUAL: Final = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}

SUITE_TOPICS: Final = (
    "joint_states",
    "friction_states",
    "motor_states",
    "motor_commands",
    "rx90_controller/joint_trajectory",
    "rx90_controller/trajectory_accepted",
    "rx90_controller/reference",
    "rx90_controller/tracking_error",
    "rx90_controller/reference_acceleration",
    "rx90_controller/commanded_current",
    "rx90_controller/motor_current",
    "robot_description",
)

_QUANTITIES: Final = {
    "friction_states": {
        "position": ("bristle deflection", "rad"),
        "velocity": ("input velocity", "rad/s"),
        "effort": ("friction torque", "Nm"),
    },
    # JointState has no field for these.
    "reference_acceleration": {"effort": ("acceleration", "rad/s^2")},
    "commanded_current": {"effort": ("current", "A")},
    "motor_current": {"effort": ("current", "A")},
}
"""What the fields of a topic's messages hold where it is not what they are called."""


def quantities(topic: str) -> dict[str, str]:
    """Return what each field of a topic's messages holds, with its unit, such as `position [rad]`."""
    return {field: f"{name} [{unit}]" for field, (name, unit) in _fields(topic).items()}


def unit(topic: str, field: str) -> str:
    """Return the unit of a field of a topic's messages."""
    return _fields(topic)[field][1]


def _fields(topic: str) -> dict[str, tuple[str, str]]:
    own = _QUANTITIES.get(topic.rpartition("/")[2], {})
    return {field: own.get(field, (field, _USUAL[field])) for field in FIELDS}


def absolute(topic: str) -> str:
    """Return the topic's name as bags hold it, with the leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"
