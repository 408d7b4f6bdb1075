"""Start rclpy; what ROS refuses is one line for the user."""

from __future__ import annotations

from collections.abc import Sequence

import rclpy
from rclpy.context import Context
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.signals import SignalHandlerOptions

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import plain

_REASON = 400  # characters; ROS explains at length where a name is wrong


def start_ros(args: Sequence[str], context: Context | None = None) -> None:
    """Initialise rclpy without its own handling of signals, which would pull the context away under a wait.

    Raises:
        ConfigError: if it refuses the arguments or the environment.
    """
    # rcl would print a refusal itself, beside the line that the error becomes.
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=list(args), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise _refused(args, error) from error
    set_logger_level("rcl", LoggingSeverity.UNSET)


def reason(error: Exception) -> str:
    """Return what ROS says, in one line and without the place in its source."""
    return plain(" ".join(str(error).split(", at /")[0].split()), _REASON)


def _refused(args: Sequence[str], error: Exception) -> ConfigError:
    if not args:
        return ConfigError(f"ROS does not start: {reason(error)}")
    return ConfigError(f"ROS arguments {plain(' '.join(args))}: refused ({reason(error)})")
