"""Quality of service of the suite's topics."""

from __future__ import annotations

from typing import Final

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


# Deep enough that a recorder which does not run for a second loses nothing. KEEP_ALL would stop the tick instead, for
# as long as the lease of a recorder that was killed.
TICK_QOS: Final = _reliable(8000)
STATE_QOS: Final = _reliable(2000)
CLOCK_QOS: Final = _reliable(10)
LATCHED_QOS: Final = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
# A burst is answered one by one, each with a line of its own; planning takes longer than sending.
TRAJECTORY_QOS: Final = _reliable(1000)
