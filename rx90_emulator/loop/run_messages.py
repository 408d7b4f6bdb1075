"""Messages of a run beside its series, as the nodes would have published them: trajectories and parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.bags.topics import JOINT_TRAJECTORY, PARAMETER_EVENT, POINT_FIELDS
from rx90_common.bags.writing import SingleMessage
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.message_types import typestore

_INTEGER = 2  # of rcl_interfaces/ParameterType


def parameter_message(topic: str, node: str, name: str, number: int) -> SingleMessage:
    """Return the rcl_interfaces/ParameterEvent of a node with a whole number at the start of its run."""
    types = typestore().types
    no_arrays = [np.empty(0)] * 4
    value = types["rcl_interfaces/msg/ParameterValue"](
        _INTEGER, False, number, 0.0, "", *no_arrays, []
    )
    new = [types["rcl_interfaces/msg/Parameter"](name, value)]
    zero = types["builtin_interfaces/msg/Time"](0, 0)
    return SingleMessage(topic, 0, types[PARAMETER_EVENT](zero, node, new, [], []))


def trajectory_message(topic: str, start_ns: int, content: dict[str, Any]) -> SingleMessage:
    """Return a trajectory_msgs/JointTrajectory that starts at `start_ns`, from its content as YAML has it."""
    types = typestore().types
    points = []
    for values in content["points"]:
        vectors = [np.array(values.get(name) or [], dtype=np.float64) for name in POINT_FIELDS]
        since = types["builtin_interfaces/msg/Duration"](**values["time_from_start"])
        points.append(types["trajectory_msgs/msg/JointTrajectoryPoint"](*vectors, since))
    stamp = types["builtin_interfaces/msg/Time"](*divmod(start_ns, NANOSECONDS))
    header = types["std_msgs/msg/Header"](stamp, "")
    return SingleMessage(
        topic, start_ns, types[JOINT_TRAJECTORY](header, content["joint_names"], points)
    )
