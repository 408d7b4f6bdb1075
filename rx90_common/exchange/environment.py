"""What an entry point sets before rclpy starts; a value that the user has set wins."""

from __future__ import annotations

import ctypes
import os

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.base.share import config_path

_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"  # Jazzy's Fast DDS 2.14 does not read FASTDDS_DEFAULT_PROFILES_FILE
_LAST_DOMAIN = 232  # the ports of higher ones do not exist
_FAST_DDS = "rmw_fastrtps_cpp"
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def prepare() -> None:
    """Set the environment of Fast DDS; every process of the suite calls this before `rclpy.init`.

    - UDP instead of shared memory: a killed process leaves no segments behind whose remains the next start reports
      as errors. With the range LOCALHOST rmw_fastrtps adds shared memory whatever FASTDDS_BUILTIN_TRANSPORTS says;
      there a profile with UDP on 127.0.0.1 alone takes the place of the range, with the same reach.
    - Profiles whose reasons stand in config/dds/profiles.xml.

    Raises:
        ConfigError: for a domain or a middleware that cannot be, which ROS itself would end the process for.

    Another middleware, profiles of the user's own, and static peers are left as they are.
    """
    _check_domain()
    if not _is_fast_dds() or _PROFILES in os.environ:
        return
    if os.environ.get(_RANGE, "").upper() == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS"):
        os.environ[_RANGE] = "SYSTEM_DEFAULT"  # or rmw_fastrtps would add its own transports to the profile's
        os.environ[_PROFILES] = str(config_path("dds/localhost.xml"))
    else:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        os.environ[_PROFILES] = str(config_path("dds/profiles.xml"))


def _check_domain() -> None:
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isascii() and domain.isdecimal() and int(domain) <= _LAST_DOMAIN):
        raise ConfigError(f"ROS_DOMAIN_ID is {quoted(domain)}; accepted: a whole number from 0 to {_LAST_DOMAIN}")


def _is_fast_dds() -> bool:
    name = os.environ.get("RMW_IMPLEMENTATION") or _FAST_DDS
    if name == _FAST_DDS:
        return True
    try:
        ctypes.CDLL(f"lib{name}.so")
    except OSError:
        raise ConfigError(
            f"RMW_IMPLEMENTATION is {quoted(name)}, which is not installed here; accepted: {_FAST_DDS}, or unset it"
        ) from None
    return False
