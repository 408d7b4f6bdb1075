"""Which robot a bag says that it is of; needs no ROS."""

from __future__ import annotations

import re
from pathlib import Path

from rx90_common.bags.storage import BagReader
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain, quoted

_TOPIC, _STRING = "robot_description", "std_msgs/msg/String"
_NAME = re.compile(r"""<robot\b[^>]*?\bname\s*=\s*["']([^"']*)["']""")


def robot_of(path: Path | str) -> str | None:
    """Return the name in the first description of a robot in a bag; None if there is no description, or no name in it.

    Raises:
        BagError: if the bag cannot be read.
    """
    with BagReader(path) as bag:
        topics = [t for t in bag.topics if t.msgtype == _STRING and t.name.rpartition("/")[2] == _TOPIC]
        first = next(bag.messages(topics), None) if topics else None
        found = first and _NAME.search(str(bag.deserialize(first[0], first[2]).data))
    return found[1] if found else None


def check_robot(path: Path | str, robot: str) -> None:
    """Check that a bag is of a robot: that the first description in it, if there is one, bears its name.

    Raises:
        BagError: if the bag cannot be read, or is another robot's.
    """
    found = robot_of(path)
    if found not in (None, robot):
        raise BagError(
            f"{plain(path)}: recorded of the robot {quoted(found)}, not of {quoted(robot)}; accepted: a bag of "
            "that robot, or --robot with the bag's"
        )
