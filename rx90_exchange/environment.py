"""What an entry point sets before rclpy starts; a value that the user has set wins."""

from __future__ import annotations

import os

from rx90_common.share import config_path

_PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"  # Jazzy's Fast DDS 2.14 does not read FASTDDS_DEFAULT_PROFILES_FILE
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def prepare() -> None:
    """Set the environment of Fast DDS; every process of the suite calls this before `rclpy.init`.

    - UDP instead of shared memory: a killed process leaves no segments behind whose remains the next start reports
      as errors. With the range LOCALHOST rmw_fastrtps adds shared memory whatever FASTDDS_BUILTIN_TRANSPORTS says;
      there a profile with UDP on 127.0.0.1 alone takes the place of the range, with the same reach.
    - Profiles whose reasons stand in config/dds/profiles.xml.

    Another middleware, profiles of the user's own, and static peers are left as they are.
    """
    if os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp") != "rmw_fastrtps_cpp" or _PROFILES in os.environ:
        return
    if os.environ.get(_RANGE, "").upper() == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS"):
        os.environ[_RANGE] = "SYSTEM_DEFAULT"  # or rmw_fastrtps would add its own transports to the profile's
        os.environ[_PROFILES] = str(config_path("dds/localhost.xml"))
    else:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        os.environ[_PROFILES] = str(config_path("dds/profiles.xml"))
