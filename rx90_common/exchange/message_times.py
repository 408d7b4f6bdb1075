"""Times in nanoseconds as messages; `rx90_common.base.stamps` reads them."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from rx90_common.base.rates import NANOSECONDS


def ros_time(nanoseconds: int) -> Time:
    """Return a time, ns, as a message."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)
