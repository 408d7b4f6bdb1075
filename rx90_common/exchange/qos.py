"""The quality of service of each kind of topic."""

from __future__ import annotations

from typing import Final, NamedTuple

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


class Reliable(NamedTuple):
    """A reliable quality of service that keeps `depth` messages, `latched` also for subscribers that come later."""

    depth: int
    latched: bool = False

    @property
    def profile(self) -> QoSProfile:
        """Return it as rclpy has it."""
        durability = DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=self.depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


# Deep enough that a recorder which does not run for a second loses nothing. KEEP_ALL would stop the tick instead, for
# as long as the lease of a recorder that was killed.
TICK_QOS: Final = Reliable(8000)
STATE_QOS: Final = Reliable(2000)
CLOCK_QOS: Final = Reliable(10)
LATCHED_QOS: Final = Reliable(1, latched=True)
# A burst is answered one by one, each with a line of its own; planning takes longer than sending.
TRAJECTORY_QOS: Final = Reliable(1000)
# ROS keeps 10 requests that wait for their turn, and drops the next ones without a word.
REQUEST_QOS: Final = Reliable(2000)
