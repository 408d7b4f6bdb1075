"""Start ROS: the environment of its middleware, rclpy itself, and checks for control_msgs.

Modules of ROS are imported only when they are needed.
"""

from __future__ import annotations

import ctypes
import importlib
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.share import config_path
from rx90_common.process.requirements import missing_module

if TYPE_CHECKING:
    from rclpy.context import Context

_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"  # Jazzy's Fast DDS 2.14 does not read FASTDDS_DEFAULT_PROFILES_FILE
_LAST_DOMAIN = 232  # the ports of higher ones do not exist
_FAST_DDS = "rmw_fastrtps_cpp"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_REASON = 400  # characters; ROS explains at length where a name is wrong


def prepare() -> None:
    """Set the environment of Fast DDS; every process of the suite calls this before `rclpy.init`.

    - UDP instead of shared memory: a killed process leaves no segments behind whose remains the next start reports
      as errors. With the range LOCALHOST rmw_fastrtps adds shared memory whatever FASTDDS_BUILTIN_TRANSPORTS says;
      then a profile with UDP on 127.0.0.1 alone replaces the range, with the same reach.
    - Profiles, explained in config/dds/profiles.xml.

    Another middleware, profiles of the user's own, and static peers are left as they are.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isascii() and domain.isdecimal() and int(domain) <= _LAST_DOMAIN):
        raise ConfigError(
            f"ROS_DOMAIN_ID is {quoted(domain)}; accepted: a whole number from 0 to {_LAST_DOMAIN}"
        )
    middleware = os.environ.get("RMW_IMPLEMENTATION") or _FAST_DDS
    if middleware != _FAST_DDS:
        try:
            ctypes.CDLL(f"lib{middleware}.so")
        except OSError:
            raise ConfigError(
                f"RMW_IMPLEMENTATION is {quoted(middleware)}, which is not installed here; accepted: {_FAST_DDS}, or "
                "unset it"
            ) from None
    elif _PROFILES not in os.environ:
        if os.environ.get(_RANGE, "").upper() == "LOCALHOST" and not os.environ.get(
            "ROS_STATIC_PEERS"
        ):
            # or rmw_fastrtps would add its own transports to the profile's
            os.environ[_RANGE] = "SYSTEM_DEFAULT"
            os.environ[_PROFILES] = str(config_path("dds/localhost.xml"))
        else:
            os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
            os.environ[_PROFILES] = str(config_path("dds/profiles.xml"))


def start_ros(args: Sequence[str], context: Context | None = None) -> None:
    """Initialise rclpy without its own handling of signals, which would pull the context away under a wait."""
    import rclpy
    from rclpy.impl.logging_severity import LoggingSeverity
    from rclpy.logging import set_logger_level
    from rclpy.signals import SignalHandlerOptions

    # rcl would print a refusal itself, besides the line of the error.
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=list(args), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        if not args:
            raise ConfigError(f"ROS does not start: {reason(error)}") from error
        raise ConfigError(
            f"ROS arguments {plain(' '.join(args))}: refused ({reason(error)})"
        ) from error
    set_logger_level("rcl", LoggingSeverity.UNSET)


def reason(error: Exception) -> str:
    """Return ROS' error text in one line, without the place in its source."""
    return plain(" ".join(str(error).split(", at /")[0].split()), _REASON)


def missing_messages(package: str) -> str | None:
    """Return None if a package of messages can be used; else a line with what is missing and how to get it."""
    try:
        importlib.import_module(f"{package}.{package}_s__rosidl_typesupport_c")
    except ImportError as error:
        return missing_module(error) or str(error)
    return None


def controller_topic(node: Any, controller: str) -> str:
    """Return the absolute name of the topic on which a controller node, relative or absolute, takes trajectories."""
    accepted = "accepted: a name such as rx90_controller or /cell/rx90_controller"
    if not controller:  # with which the topic would have a name too, an absolute one
        raise ConfigError(f"the controller node's name is empty; {accepted}")
    try:
        return str(node.resolve_topic_name(f"{controller}/joint_trajectory"))
    except RuntimeError as error:
        raise ConfigError(
            f"the controller node's name is {quoted(controller)} ({reason(error)}); {accepted}"
        ) from error
