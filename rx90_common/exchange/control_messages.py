"""Whether control_msgs is there: without it a controller runs with its topics and services, and without the action."""

from __future__ import annotations

from rx90_common.base.requirements import missing_module


def missing_control_msgs() -> str | None:
    """Return None where control_msgs can be used; else in one line what is missing and how to get it.

    Where nothing is there it costs a search for the folder; what it imports otherwise is what the action needs.
    """
    try:
        from control_msgs import control_msgs_s__rosidl_typesupport_c  # noqa: F401
        from control_msgs.action import FollowJointTrajectory  # noqa: F401
        from control_msgs.msg import JointTrajectoryControllerState, SpeedScalingFactor  # noqa: F401
        from control_msgs.srv import QueryTrajectoryState  # noqa: F401
    except ImportError as error:
        return missing_module(error) or str(error)
    return None
